//! faer's scratch memory, allocated once.

use std::fmt;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};

/// A stack of scratch memory of a fixed size.
pub(super) struct Scratch(MemBuffer);

impl Scratch {
    pub(super) fn new(requirement: StackReq) -> Self {
        Self(MemBuffer::new(requirement))
    }

    pub(super) fn stack(&mut self) -> &mut MemStack {
        MemStack::new(&mut self.0)
    }
}

impl fmt::Debug for Scratch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scratch").field("bytes", &self.0.len()).finish()
    }
}
