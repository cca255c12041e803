//! What the person can do for a faster network, as sentences.

/// Receive buffer that the driver asks for.
pub(crate) const SOCKET_BUFFER: u32 = 64 << 20;
/// Packets of at least this size are jumbo frames.
const JUMBO: u32 = 8000;

/// Aravis enlarges its buffer with the first packet it sees; until then the system's own size must do.
const FIRST_FRAME: u32 = 4 << 20;

/// What the system allows, in bytes; `None` where it does not say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ReceiveBuffers {
    /// `net.core.rmem_max`.
    pub(crate) largest: Option<u32>,
    /// `net.core.rmem_default`.
    pub(crate) first: Option<u32>,
}

/// What is to be improved.
pub(crate) fn sentences(buffers: ReceiveBuffers, packet_size: Option<u32>, can_resend: bool) -> Vec<String> {
    let mut advice = Vec::new();
    if let Some(limit) = buffers.largest.filter(|&limit| limit < SOCKET_BUFFER) {
        advice.push(format!(
            "the system limits receive buffers to {limit} bytes (net.core.rmem_max), frames may lose packets; \
             allow {SOCKET_BUFFER} with: sysctl -w net.core.rmem_max={SOCKET_BUFFER}"
        ));
    }
    if let Some(first) = buffers.first.filter(|&first| first < FIRST_FRAME) {
        advice.push(format!(
            "new receive buffers have {first} bytes (net.core.rmem_default), the first frame after arming may lose \
             packets; give it {FIRST_FRAME} with: sysctl -w net.core.rmem_default={FIRST_FRAME}"
        ));
    }
    if let Some(size) = packet_size.filter(|&size| size < JUMBO) {
        advice.push(format!(
            "packets have {size} bytes; set an MTU of 9000 (jumbo frames) on network card and switch to need \
             less of the processor"
        ));
    }
    if !can_resend {
        advice.push("the camera cannot send lost packets again; each one costs a frame".to_owned());
    }
    advice
}

/// What this computer allows.
pub(crate) fn receive_buffers() -> ReceiveBuffers {
    let setting = |name: &str| {
        let text = std::fs::read_to_string(format!("/proc/sys/net/core/{name}")).ok()?;
        text.trim().parse().ok()
    };
    ReceiveBuffers { largest: setting("rmem_max"), first: setting("rmem_default") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_wrong_is_advised() {
        let ample = ReceiveBuffers { largest: Some(SOCKET_BUFFER), first: Some(FIRST_FRAME) };
        assert!(sentences(ample, Some(9000), true).is_empty());
        let small = ReceiveBuffers { largest: Some(212_992), first: Some(212_992) };
        let all = sentences(small, Some(1500), false);
        assert_eq!(all.len(), 4);
        assert!(all[0].contains("net.core.rmem_max=67108864"), "{all:?}");
        assert!(all[1].contains("net.core.rmem_default=4194304") && all[2].contains("jumbo"), "{all:?}");
    }
}
