//! GenICam cameras through Aravis.
