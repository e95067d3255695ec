//! The driver's compiled pipelines in a file, so that the next process need not compile them again.
//!
//! The file stands in the folder that `NEARFIELD_PIPELINE_CACHE` names (`off` for none), else in the user's cache folder, one for each kind of
//! adapter. It is read when a device is opened and written when one is dropped, or when its work is waited for a while after the last new pipeline: into
//! another file that then takes its name, so that no process sees half of one. Whatever goes wrong with it is told to `log` at level debug, and pipelines
//! are compiled as ever. A file is used only where its checksum is right, and library, adapter and driver are those that it was written with: drivers
//! trust what they are given. As for any cache of a driver, others must not be able to write to the folder.

use std::ffi::OsString;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// First bytes of a file.
const MAGIC: &[u8; 24] = b"nearfield pipelines 1\r\n\x1a";
/// Bytes of magic, checksum and length.
const HEAD: usize = MAGIC.len() + 16;
/// Larger files are not read and not written.
const MOST_BYTES: u64 = 256 << 20;
/// After so long without a new pipeline the file is written.
const QUIET: Duration = Duration::from_secs(1);

/// The cache of one device and its file.
#[derive(Debug)]
pub(super) struct DiskCache {
    raw: wgpu::PipelineCache,
    file: PathBuf,
    identity: String,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// When the last pipeline was compiled that the file may not have.
    new_at: Option<Instant>,
    /// Head of the file as this process knows it.
    head: Option<[u8; HEAD]>,
}

impl DiskCache {
    /// The cache of a device that was opened with the feature; `None` where the backend has none. What the driver has against it goes to the error scope.
    pub(super) fn open(device: &wgpu::Device, folder: &Path) -> Option<Self> {
        if !device.features().contains(wgpu::Features::PIPELINE_CACHE) {
            return None;
        }
        let info = device.adapter_info();
        let file = folder.join(wgpu::util::pipeline_cache_key(&info)?).with_extension("bin");
        let identity = format!("{}\n{}\n{}\n{}", env!("CARGO_PKG_VERSION"), info.name, info.driver, info.driver_info);
        let data = match read(&file, &identity) {
            Ok(data) => Some(data),
            Err(error) => {
                log::debug!("pipeline cache {} is not used: {error}", file.display());
                None
            }
        };
        let descriptor = wgpu::PipelineCacheDescriptor {
            label: Some("nearfield pipelines"),
            data: data.as_deref(),
            // An empty cache where the driver does not know the data any more.
            fallback: true,
        };
        // SAFETY: the data, if any, come from `get_data` with an adapter and a driver of these names, by the checksum that was written with them.
        let raw = unsafe { device.create_pipeline_cache(&descriptor) };
        let head = data.map(|data| head_of(&identity, &data));
        Some(Self { raw, file, identity, state: Mutex::new(State { new_at: None, head }) })
    }

    /// The cache.
    pub(super) fn raw(&self) -> &wgpu::PipelineCache {
        &self.raw
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says that a pipeline was compiled.
    pub(super) fn added(&self) {
        self.state().new_at = Some(Instant::now());
    }

    /// Writes the file if there are new pipelines, the last of them a while ago.
    pub(super) fn save_if_quiet(&self) {
        let mut state = self.state();
        if state.new_at.is_some_and(|at| at.elapsed() > QUIET) {
            self.save(&mut state);
        }
    }

    /// Writes the file, unless that is what it holds already.
    fn save(&self, state: &mut State) {
        state.new_at = None;
        let Some(data) = self.raw.get_data() else { return };
        let head = head_of(&self.identity, &data);
        if state.head.replace(head) == Some(head) {
            return;
        }
        if let Err(error) = write(&self.file, &self.identity, &data) {
            log::debug!("pipeline cache {} is not written: {error}", self.file.display());
        }
    }
}

impl Drop for DiskCache {
    fn drop(&mut self) {
        let mut state = self.state();
        if state.new_at.is_some() {
            self.save(&mut state);
        }
    }
}

/// The folder of the files by the environment; `None` where there shall be none, or no place for one is known.
pub(super) fn folder() -> Option<PathBuf> {
    folder_by(|name| std::env::var_os(name))
}

fn folder_by(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let path = |name: &str| variable(name).map(PathBuf::from).filter(|path| path.is_absolute());
    match variable("NEARFIELD_PIPELINE_CACHE") {
        Some(off) if off == "off" => None,
        Some(named) if !named.is_empty() => Some(named.into()),
        _ => {
            let of_user = if cfg!(windows) {
                path("LOCALAPPDATA")
            } else if cfg!(target_os = "macos") {
                path("HOME").map(|home| home.join("Library/Caches"))
            } else {
                path("XDG_CACHE_HOME").or_else(|| path("HOME").map(|home| home.join(".cache")))
            };
            Some(of_user?.join("nearfield"))
        }
    }
}

fn damaged(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

/// The data of a file that was written for this identity.
fn read(file: &Path, identity: &str) -> io::Result<Vec<u8>> {
    let mut source = fs::File::open(file)?;
    let length = source.metadata()?.len();
    if !(HEAD as u64..=MOST_BYTES).contains(&length) {
        return Err(damaged("it is too short or too long"));
    }
    let mut bytes = Vec::new();
    source.by_ref().take(MOST_BYTES).read_to_end(&mut bytes)?;
    let (head, data) = bytes.split_at_checked(HEAD).ok_or_else(|| damaged("it is too short"))?;
    if head != head_of(identity, data) {
        return Err(damaged("it is damaged, or of another library, adapter or driver"));
    }
    bytes.drain(..HEAD);
    Ok(bytes)
}

/// Writes a file as a whole: others see the old one or the new one.
fn write(file: &Path, identity: &str, data: &[u8]) -> io::Result<()> {
    if data.len() as u64 > MOST_BYTES - HEAD as u64 {
        return Err(damaged("it has become too large"));
    }
    let folder = file.parent().ok_or_else(|| damaged("it has no folder"))?;
    create_folder(folder)?;
    let process = std::process::id();
    // Two devices of a process may write at the same time.
    let unfinished = file.with_extension(format!("{process}-{:x}", std::ptr::from_ref(data).addr()));
    let written = fs::write(&unfinished, [&head_of(identity, data)[..], data].concat());
    let renamed = written.and_then(|()| fs::rename(&unfinished, file));
    if renamed.is_err() {
        let _ = fs::remove_file(&unfinished);
    }
    renamed
}

/// Makes the folder for the user alone.
fn create_folder(folder: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

fn head_of(identity: &str, data: &[u8]) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    let (magic, numbers) = head.split_at_mut(MAGIC.len());
    magic.copy_from_slice(MAGIC);
    numbers[..8].copy_from_slice(&checksum(checksum(0, identity.as_bytes()), data).to_le_bytes());
    numbers[8..].copy_from_slice(&(data.len() as u64).to_le_bytes());
    head
}

/// FNV-1a over words of eight bytes, the last filled up with zeros, with a rotation that brings the high bits into play.
fn checksum(start: u64, bytes: &[u8]) -> u64 {
    let word = |chunk: &[u8]| {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        u64::from_le_bytes(word)
    };
    let mix = |sum: u64, chunk: &[u8]| (sum ^ word(chunk)).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29);
    bytes.chunks(8).fold(start ^ 0xcbf2_9ce4_8422_2325 ^ bytes.len() as u64, mix)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_follows_the_environment() {
        let folder = |set: &[(&str, &str)]| {
            folder_by(|name| set.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).into()))
        };
        assert_eq!(folder(&[("NEARFIELD_PIPELINE_CACHE", "off"), ("HOME", "/h")]), None);
        assert_eq!(folder(&[("NEARFIELD_PIPELINE_CACHE", "here")]), Some("here".into()));
        assert_eq!(folder(&[]), None);
        if cfg!(all(unix, not(target_os = "macos"))) {
            assert_eq!(folder(&[("HOME", "/h")]), Some("/h/.cache/nearfield".into()));
            assert_eq!(folder(&[("HOME", "/h"), ("XDG_CACHE_HOME", "/x")]), Some("/x/nearfield".into()));
            assert_eq!(folder(&[("HOME", "/h"), ("XDG_CACHE_HOME", "x")]), Some("/h/.cache/nearfield".into()));
        }
    }

    #[test]
    fn every_changed_byte_and_every_cut_is_noticed() {
        let folder = std::env::temp_dir().join(format!("nearfield-pipelines-{}", std::process::id()));
        let file = folder.join("a.bin");
        let data: Vec<u8> = (0..1003u32).map(|i| ((i * 7919) >> 3) as u8).collect();
        write(&file, "this", &data).unwrap();
        assert_eq!(read(&file, "this").unwrap(), data);
        assert!(read(&file, "that").is_err());
        let whole = fs::read(&file).unwrap();
        for i in 0..whole.len() {
            let mut changed = whole.clone();
            changed[i] ^= 1 << (i % 8);
            fs::write(&file, &changed).unwrap();
            assert!(read(&file, "this").is_err(), "byte {i}");
            fs::write(&file, &whole[..i]).unwrap();
            assert!(read(&file, "this").is_err(), "cut at {i}");
        }
        fs::write(&file, [&whole[..], &[0]].concat()).unwrap();
        assert!(read(&file, "this").is_err(), "one byte more");
        write(&file, "this", &[]).unwrap();
        assert!(read(&file, "this").unwrap().is_empty());
        fs::remove_dir_all(&folder).unwrap();
    }
}
