//! What DCAM-API answers when it does not do what it was asked, and what the caller can do about it.
//!
//! Values as in the public dcamapi4 headers that open drivers mirror.

use sofiscope_hal::ErrorKind;

/// An answer that is not success; success is any number above zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Failure(pub(crate) u32);

macro_rules! failures {
    ($($name:ident = $code:literal, $kind:ident;)*) => {
        impl Failure {
            $(
                pub(crate) const $name: Self = Self($code);
            )*

            /// The name in the headers of the maker.
            pub(crate) fn name(self) -> &'static str {
                match self {
                    $(Self::$name => stringify!($name),)*
                    _ => "an unknown code",
                }
            }

            /// What the caller can do.
            pub(crate) fn kind(self) -> ErrorKind {
                match self {
                    $(Self::$name => ErrorKind::$kind,)*
                    _ => ErrorKind::Protocol,
                }
            }
        }
    };
}

failures! {
    BUSY = 0x8000_0101, Busy;
    ABORT = 0x8000_0102, Ended;
    NOTREADY = 0x8000_0103, Busy;
    NOTSTABLE = 0x8000_0104, Busy;
    UNSTABLE = 0x8000_0105, Busy;
    TIMEOUT = 0x8000_0106, Timeout;
    NOTBUSY = 0x8000_0107, Busy;
    EXCLUDED = 0x8000_0110, Busy;
    NORESOURCE = 0x8000_0201, Fault;
    NOMEMORY = 0x8000_0203, Fault;
    NOMODULE = 0x8000_0204, Lost;
    NODRIVER = 0x8000_0205, Lost;
    NOCAMERA = 0x8000_0206, Lost;
    NOGRABBER = 0x8000_0207, Lost;
    LOSTFRAME = 0x8000_0301, Fault;
    COOLINGTROUBLE = 0x8000_0302, Fault;
    NOTRIGGER = 0x8000_0303, Fault;
    TEMPERATURE_TROUBLE = 0x8000_0304, Fault;
    TOOFREQUENTTRIGGER = 0x8000_0305, Fault;
    INVALIDIMAGE = 0x8000_0321, Fault;
    INVALIDCAMERA = 0x8000_0806, Lost;
    INVALIDHANDLE = 0x8000_0807, Lost;
    INVALIDPARAM = 0x8000_0808, Protocol;
    INVALIDVALUE = 0x8000_0821, OutOfRange;
    OUTOFRANGE = 0x8000_0822, OutOfRange;
    NOTWRITABLE = 0x8000_0823, OutOfRange;
    NOTREADABLE = 0x8000_0824, OutOfRange;
    INVALIDPROPERTYID = 0x8000_0825, OutOfRange;
    NOPROPERTY = 0x8000_0828, OutOfRange;
    ACCESSDENY = 0x8000_082C, Busy;
    NOVALUETEXT = 0x8000_082D, OutOfRange;
    WRONGPROPERTYVALUE = 0x8000_082E, OutOfRange;
    INVALIDFRAMEINDEX = 0x8000_0833, Protocol;
    NOTSUPPORT = 0x8000_0F03, OutOfRange;
    MISSINGFRAME_TROUBLE = 0x8000_0F06, Fault;
    FAILOPENCAMERA = 0x8200_1001, Lost;
    FAILREADCAMERA = 0x8300_1002, Lost;
    FAILWRITECAMERA = 0x8300_1003, Lost;
    ALREADYOPENED = 0xE100_0002, Busy;
}

impl Failure {
    /// What the person can do.
    pub(crate) fn remedy(self) -> &'static str {
        match self {
            Self::ALREADYOPENED | Self::EXCLUDED => "close the other program that uses the camera",
            Self::NOCAMERA | Self::NOMODULE | Self::NODRIVER | Self::NOGRABBER => {
                "switch the camera on, check its cable and that the driver of its interface is installed"
            }
            Self::NOMEMORY | Self::NORESOURCE => "take fewer buffers or a smaller region",
            Self::COOLINGTROUBLE | Self::TEMPERATURE_TROUBLE => "check fan and water cooling of the camera",
            Self::NOTWRITABLE | Self::NOTSUPPORT | Self::INVALIDPROPERTYID => "this camera does not have it",
            _ => match self.kind() {
                ErrorKind::Lost => "check cable and power, then open the camera again",
                ErrorKind::Busy => "stop the camera first",
                ErrorKind::OutOfRange => "choose another value",
                _ => "stop the camera and open it again",
            },
        }
    }

    /// Whether a property is simply not there, which differs between models.
    pub(crate) fn is_absence(self) -> bool {
        matches!(self, Self::INVALIDPROPERTYID | Self::NOPROPERTY | Self::NOTSUPPORT)
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} (0x{:08X}); {}", self.name(), self.0, self.remedy())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_answer_tells_what_the_caller_can_do() {
        let kind = |code| Failure(code).kind();
        assert_eq!(kind(0x8000_0101), ErrorKind::Busy);
        assert_eq!(kind(0x8000_0103), ErrorKind::Busy);
        assert_eq!(kind(0x8000_0106), ErrorKind::Timeout);
        assert_eq!(kind(0x8000_0822), ErrorKind::OutOfRange);
        assert_eq!(kind(0x8300_1002), ErrorKind::Lost);
        assert_eq!(kind(0x8000_0301), ErrorKind::Fault);
        assert_eq!(kind(0x8FFF_FFFF), ErrorKind::Protocol);
        let text = Failure::BUSY.to_string();
        assert_eq!(text, "BUSY (0x80000101); stop the camera first");
    }
}
