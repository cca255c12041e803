//! Frame pairs and provenance to disk, lossless or loudly not.
