//! From what went wrong to one line on standard error and an exit code.
//!
//! 0 ok · 2 usage · 65 bad data · 66 no input · 69 no device · 70 internal · 73 cannot create · 74 input or output ·
//! 75 out of memory, a smaller request may do · 130 interrupted, what there was is written.

use std::io;
use std::path::{Path, PathBuf};

use nearfield::Error;

/// Why a command ended early.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The command line asks for something that makes no sense.
    Usage(String),
    /// A file could not be read, or its content cannot be used.
    Read(PathBuf, Error),
    /// A file could not be written.
    Write(Error),
    /// The work itself failed.
    Search(Error),
    /// Answers that must be equal differ.
    Disagreement(String),
    /// A simulation has left what can be simulated; what there was is written.
    BlowUp(String),
    /// The user ended the work; what there was is written.
    Interrupted(String),
    /// The reader of our standard output had enough.
    ClosedPipe,
}

impl Failure {
    /// A failed write to standard output.
    pub(crate) fn stdout(source: io::Error) -> Self {
        Self::writing(Error::Io { path: "standard output".into(), source })
    }

    /// A failed write.
    pub(crate) fn writing(error: Error) -> Self {
        match error {
            Error::Io { source, .. } if source.kind() == io::ErrorKind::BrokenPipe => Self::ClosedPipe,
            other => Self::Write(other),
        }
    }

    /// Bad input from `path`.
    pub(crate) fn reading(path: &Path) -> impl Fn(Error) -> Self {
        let path = path.to_owned();
        move |error| Self::Read(path.clone(), error)
    }

    /// The line for the user, without its prefix; `None` where there is nobody to tell.
    pub(crate) fn message(&self) -> Option<String> {
        let text = match self {
            Self::Usage(text) | Self::Disagreement(text) | Self::BlowUp(text) | Self::Interrupted(text) => text.clone(),
            // These two name their file themselves.
            Self::Read(_, error @ (Error::Io { .. } | Error::File(_))) => error.to_string(),
            Self::Read(path, error) => format!("{}: {error}", shown(path)),
            Self::Write(error) | Self::Search(error) => error.to_string(),
            Self::ClosedPipe => return None,
        };
        Some(one_line(&text))
    }

    /// The exit code.
    pub(crate) fn code(&self) -> u8 {
        use io::ErrorKind::{AlreadyExists, IsADirectory, NotFound, PermissionDenied, ReadOnlyFilesystem};
        match self {
            Self::ClosedPipe => 0,
            Self::Usage(_) => 2,
            Self::BlowUp(_) => 65,
            Self::Disagreement(_) => 70,
            Self::Interrupted(_) => 130,
            Self::Read(_, Error::Io { source, .. }) => match source.kind() {
                NotFound | PermissionDenied | IsADirectory => 66,
                _ => 74,
            },
            Self::Write(Error::Io { source, .. }) => match source.kind() {
                AlreadyExists | NotFound | PermissionDenied | IsADirectory | ReadOnlyFilesystem => 73,
                io::ErrorKind::NotADirectory | io::ErrorKind::InvalidInput => 73,
                _ => 74,
            },
            Self::Read(_, error) | Self::Write(error) | Self::Search(error) => code_of(error),
        }
    }
}

fn code_of(error: &Error) -> u8 {
    match error {
        Error::NonFinite { .. } | Error::CoordinateTooLarge { .. } | Error::File(_) => 65,
        Error::LengthMismatch { .. } | Error::TooMany { .. } | Error::NoTriangles { .. } | Error::NoNormals { .. } => {
            65
        }
        Error::InvalidRadius { .. } | Error::InvalidSetting { .. } | Error::Unsupported { .. } => 2,
        Error::OutOfMemory { .. } | Error::OutOfDeviceMemory { .. } => 75,
        Error::NoDevice { .. } | Error::DeviceLost { .. } | Error::Device { .. } => 69,
        Error::Io { .. } => 74,
        _ => 70,
    }
}

/// How a path is called in messages.
pub(crate) fn shown(path: &Path) -> String {
    if path == Path::new("-") { "standard input".to_owned() } else { path.display().to_string() }
}

/// Messages of compilers and command lines span lines; ours do not.
fn one_line(text: &str) -> String {
    text.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn io_error(kind: io::ErrorKind) -> Error {
        Error::Io { path: "x.ply".into(), source: kind.into() }
    }

    #[test]
    fn the_same_cause_has_another_code_for_reading_and_writing() {
        let read = |kind| Failure::Read("x.ply".into(), io_error(kind)).code();
        let write = |kind| Failure::writing(io_error(kind)).code();
        assert_eq!((read(io::ErrorKind::NotFound), write(io::ErrorKind::NotFound)), (66, 73));
        assert_eq!((read(io::ErrorKind::Other), write(io::ErrorKind::StorageFull)), (74, 74));
        assert_eq!(write(io::ErrorKind::AlreadyExists), 73);
    }

    #[test]
    fn a_closed_pipe_is_no_failure() {
        let closed = Failure::stdout(io::ErrorKind::BrokenPipe.into());
        assert_eq!((closed.code(), closed.message()), (0, None));
    }

    #[test]
    fn memory_may_be_tried_again_smaller() {
        let error = Error::OutOfMemory { what: "the list", needed: 10, available: 1 };
        assert_eq!(Failure::Search(error).code(), 75);
    }

    #[test]
    fn messages_are_one_line() {
        let error = Error::KernelRejected { kernel: "k".into(), message: "line one\n  line two\n".into() };
        assert_eq!(Failure::Search(error).message().unwrap(), "kernel k was rejected: line one; line two");
    }
}
