//! Ctrl-C: the first one asks a command to end at its next step with what it has; the second ends the process where it is.
//! Commands that do not listen end at the first, as any program does; files are whole or not there in either case.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::SIGINT;
use signal_hook::flag;

use super::{Failure, Stage};

/// Whether Ctrl-C was pressed since somebody listens.
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens from now on, until the process ends.
    ///
    /// # Errors
    /// When the system does not allow it.
    pub fn listen() -> Result<Self, Failure> {
        let asked = Arc::new(AtomicBool::new(false));
        // In this order: the second finds what the first has set.
        let second = flag::register_conditional_shutdown(SIGINT, Stage::Interrupted as i32, asked.clone());
        second
            .and_then(|_| flag::register(SIGINT, asked.clone()))
            .map_err(|e| Failure::computation(format!("cannot listen for Ctrl-C: {e}")))?;
        Ok(Self(asked))
    }

    /// Whether the command should end.
    pub fn asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
