//! [`Inherited`]: the state that nodes pass on to those below. Decode threads.

/// OSG's flags.
pub(in crate::formats::osg) const ON: u32 = 1;
const OVERRIDE: u32 = 2;
const PROTECTED: u32 = 4;
const INHERIT: u32 = 8;

/// A value that state sets pass on to what is below.
#[derive(Clone)]
pub(in crate::formats::osg) struct Inherited<T> {
    pub value: T,
    is_overridden: bool,
}

impl<T> Inherited<T> {
    pub const fn new(value: T) -> Self {
        Self { value, is_overridden: false }
    }

    pub fn apply(&mut self, value: T, flags: u32) {
        if flags & INHERIT == 0 && (!self.is_overridden || flags & PROTECTED != 0) {
            self.value = value;
            self.is_overridden = flags & OVERRIDE != 0;
        }
    }
}
