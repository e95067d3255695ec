//! The user's wish to end (Ctrl-C, or the signal to terminate) as a flag, for work that has something to keep.

use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);

/// Sets the flag; the second time the process ends at once.
extern "C" fn ask(signal: libc::c_int) {
    ASKED.store(true, Ordering::Relaxed);
    // SAFETY: `signal` may be called in a handler, and the default action is no function of ours.
    unsafe { libc::signal(signal, libc::SIG_DFL) };
}

/// From now on the first Ctrl-C does not end the process but makes [`asked`] true.
pub(crate) fn watch() {
    let handler: extern "C" fn(libc::c_int) = ask;
    for signal in [libc::SIGINT, libc::SIGTERM] {
        // SAFETY: the handler has the signature that C asks for, and does only what is allowed in one: it stores to an
        // atomic and calls `signal`.
        unsafe { libc::signal(signal, handler as libc::sighandler_t) };
    }
}

/// Whether the user wants to end.
pub(crate) fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}
