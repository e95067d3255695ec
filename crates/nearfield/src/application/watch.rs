//! How a long computation tells how far it is, and how a caller ends it.

use std::ops::ControlFlow;

use crate::{Error, Result};

/// How far a computation is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// What is being done: "normals", "orientation".
    pub stage: &'static str,
    /// How much of it has been done.
    pub done: u64,
    /// How much there is to do.
    pub total: u64,
}

/// Is told how far a computation is, some times a second at most, and says whether it shall go on. Where it breaks, the
/// computation ends soon after with [`Error::Interrupted`].
///
/// ```
/// use std::ops::ControlFlow;
/// use nearfield::application::{Progress, Watch};
///
/// let mut print = |progress: Progress| {
///     println!("{}: {} of {}", progress.stage, progress.done, progress.total);
///     ControlFlow::Continue(())
/// };
/// let mut watch = Watch::new(&mut print);
/// watch.report("normals", 10, 100)?;
/// let mut unwatched = Watch::none();
/// unwatched.report("normals", 10, 100)?;
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Default)]
pub struct Watch<'a> {
    tell: Option<&'a mut dyn FnMut(Progress) -> ControlFlow<()>>,
}

impl<'a> Watch<'a> {
    /// Watches by a function.
    pub fn new(tell: &'a mut dyn FnMut(Progress) -> ControlFlow<()>) -> Self {
        Self { tell: Some(tell) }
    }

    /// Nobody watches, and the computation runs to its end.
    pub fn none() -> Self {
        Self::default()
    }

    /// Tells how far the computation is.
    ///
    /// # Errors
    /// `Interrupted` where the caller wants to end.
    pub fn report(&mut self, stage: &'static str, done: u64, total: u64) -> Result<()> {
        match self.tell.as_mut().map(|tell| tell(Progress { stage, done, total })) {
            Some(ControlFlow::Break(())) => Err(Error::Interrupted { stage, done, total }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_caller_can_end_a_computation() {
        let mut told = Vec::new();
        let mut tell = |progress: Progress| {
            told.push(progress.done);
            if progress.done < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let mut watch = Watch::new(&mut tell);
        let ended = (0..9).try_for_each(|done| watch.report("counting", done, 9));
        assert!(matches!(ended, Err(Error::Interrupted { stage: "counting", done: 2, total: 9 })));
        assert_eq!(told, [0, 1, 2]);
    }
}
