//! Ctrl-C, and SIGTERM as Slurm, systemd and `kill` send it: the first one asks a command to end at its next step with what it has;
//! the second ends the process where it is. Commands that do not listen, or not yet, as while an input is a pipe that nobody writes to,
//! end at the first, as any program does; files are whole or not there in either case.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::{Failure, Stage};

/// Whether one of the signals came since somebody listens.
pub struct Interrupt {
    asked: Arc<AtomicBool>,
    /// The exit code of the last one.
    code: Arc<AtomicUsize>,
}

impl Interrupt {
    /// Listens from now on, until the process ends.
    ///
    /// # Errors
    /// When the system does not allow it.
    pub fn listen() -> Result<Self, Failure> {
        let (asked, code) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
        for (signal, stage) in [(SIGINT, Stage::Interrupted), (SIGTERM, Stage::Terminated)] {
            // In this order: the second finds what the first has set.
            flag::register_conditional_shutdown(signal, stage as i32, asked.clone())
                .and_then(|_| flag::register_usize(signal, code.clone(), stage as usize))
                .and_then(|_| flag::register(signal, asked.clone()))
                .map_err(|e| Failure::computation(format!("cannot listen for Ctrl-C and SIGTERM: {e}")))?;
        }
        Ok(Self { asked, code })
    }

    /// Whether the command should end.
    pub fn asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }

    /// How it ends if it does because of that.
    pub fn failure(&self, message: String) -> Failure {
        let terminated = self.code.load(Ordering::Relaxed) == Stage::Terminated as usize;
        Failure::new(if terminated { Stage::Terminated } else { Stage::Interrupted }, message)
    }
}
