//! The newest value for whoever looks: older ones are replaced, neither side waits.
//!
//! In: values. Out: the newest one and how many there have been. Never: waits. Fails: not at all.

use triple_buffer::{Input, Output, TripleBuffer};

/// The end that writes.
#[derive(Debug)]
pub struct Publisher<T: Send> {
    input: Input<Numbered<T>>,
    published: u64,
}

/// The end that looks.
#[derive(Debug)]
pub struct Viewer<T: Send> {
    output: Output<Numbered<T>>,
}

#[derive(Debug, Clone)]
struct Numbered<T> {
    number: u64,
    value: T,
}

/// Both ends, beginning with one value.
#[must_use]
pub fn latest<T: Clone + Send>(first: T) -> (Publisher<T>, Viewer<T>) {
    let (input, output) = TripleBuffer::new(&Numbered { number: 0, value: first }).split();
    (Publisher { input, published: 0 }, Viewer { output })
}

impl<T: Send> Publisher<T> {
    /// Replaces the newest value.
    pub fn publish(&mut self, value: T) {
        self.published += 1;
        self.input.write(Numbered { number: self.published, value });
    }
}

impl<T: Send> Viewer<T> {
    /// The newest value.
    pub fn look(&mut self) -> &T {
        &self.output.read().value
    }

    /// The newest value if it is another than at the last look, and its number, counted from 1.
    pub fn look_if_new(&mut self) -> Option<(u64, &T)> {
        if !self.output.update() {
            return None;
        }
        let Numbered { number, value } = self.output.output_buffer();
        Some((*number, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_newest_value_is_seen_and_its_number_tells_how_many_were_not() {
        let (mut publisher, mut viewer) = latest("none");
        assert_eq!(*viewer.look(), "none");
        assert!(viewer.look_if_new().is_none());
        publisher.publish("one");
        publisher.publish("two");
        assert_eq!(viewer.look_if_new(), Some((2, &"two")));
        assert!(viewer.look_if_new().is_none());
        assert_eq!(*viewer.look(), "two");
    }
}
