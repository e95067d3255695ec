//! Output files: what can be known to fail before the work is done.

use std::path::Path;

use nearfield::Error;
use nearfield::io::Format;

use crate::exit::Failure;

/// Refuses a file that exists and may not be replaced, or a folder that is not there.
pub(crate) fn check(path: &Path, force: bool) -> Result<(), Failure> {
    if path == Path::new("-") {
        return Ok(());
    }
    let failed = |source| Failure::writing(Error::Io { path: path.to_owned(), source });
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => return Err(failed(std::io::ErrorKind::IsADirectory.into())),
        Ok(metadata) if metadata.is_file() && !force => {
            let message = "the file exists; replace it with --force";
            return Err(failed(std::io::Error::new(std::io::ErrorKind::AlreadyExists, message)));
        }
        _ => {}
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::metadata(folder).map(drop).map_err(failed)
}

/// The format of an output file, by name or by extension.
pub(crate) fn format(path: &Path, named: Option<Format>) -> Result<Format, Failure> {
    match named {
        Some(format) => Ok(format),
        None if path == Path::new("-") => {
            Err(Failure::Usage("standard output has no extension: say the format of the output".into()))
        }
        None => Format::from_path(path).map_err(Failure::Search),
    }
}

/// How an output is called in messages.
pub(crate) fn shown(path: &Path) -> String {
    if path == Path::new("-") { "standard output".to_owned() } else { path.display().to_string() }
}
