//! What the person can do for a faster network, as sentences.

/// Receive buffer that the driver asks for.
pub(crate) const SOCKET_BUFFER: u32 = 64 << 20;
/// Packets of at least this size are jumbo frames.
const JUMBO: u32 = 8000;

/// What is to be improved; `receive_limit` is `net.core.rmem_max`.
pub(crate) fn sentences(
    receive_limit: Option<u32>,
    packet_size: Option<u32>,
    can_resend: bool,
) -> Vec<String> {
    let mut advice = Vec::new();
    if let Some(limit) = receive_limit.filter(|&limit| limit < SOCKET_BUFFER) {
        advice.push(format!(
            "the system limits receive buffers to {limit} bytes (net.core.rmem_max), frames may lose packets; \
             allow {SOCKET_BUFFER} with: sysctl -w net.core.rmem_max={SOCKET_BUFFER}"
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

/// `net.core.rmem_max` of this computer.
pub(crate) fn receive_limit() -> Option<u32> {
    std::fs::read_to_string("/proc/sys/net/core/rmem_max").ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_wrong_is_advised() {
        assert!(sentences(Some(SOCKET_BUFFER), Some(9000), true).is_empty());
        let all = sentences(Some(212_992), Some(1500), false);
        assert_eq!(all.len(), 3);
        assert!(all[0].contains("net.core.rmem_max=67108864") && all[1].contains("jumbo"), "{all:?}");
    }
}
