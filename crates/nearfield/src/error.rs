//! The one error type of the library: each variant says what was asked, what was found and what to do.

use std::path::PathBuf;

/// `Result` with [`enum@Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Everything that can go wrong, with the numbers that explain it.
#[non_exhaustive]
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Coordinates that are NaN or infinite.
    #[error(
        "{count} of the {what} have a NaN or infinite coordinate, the first at index {first}; \
         drop them first (`PointCloud::drop_invalid`, `--drop-invalid`)"
    )]
    NonFinite {
        /// What was being read: "points" or "queries".
        what: &'static str,
        /// How many are invalid.
        count: u64,
        /// Index of the first one.
        first: u64,
    },

    /// A finite coordinate too far out for its square to be an f32.
    #[error(
        "coordinate {value:e} on axis {axis} of {what} {index} is beyond ±1e18, the largest supported; shift or scale the data"
    )]
    CoordinateTooLarge {
        /// What was being read: "points" or "queries".
        what: &'static str,
        /// Index of the first such element.
        index: u64,
        /// 'x', 'y' or 'z'.
        axis: char,
        /// The value found.
        value: f64,
    },

    /// A finite coordinate of a point in any dimension too far out for its square to be a number of its type.
    #[error(
        "coordinate {value:e} on axis {axis} of {what} {index} is beyond ±{limit:e}, the largest supported; shift or scale \
         the data"
    )]
    CoordinateBeyond {
        /// What was being read: "points" or "queries".
        what: &'static str,
        /// Index of the first such element.
        index: u64,
        /// The axis, from 0 on.
        axis: usize,
        /// The value found.
        value: f64,
        /// The largest one possible.
        limit: f64,
    },

    /// Coordinates outside the domain that was given for them.
    #[error(
        "{count} of the {what} lie outside the given domain, the first at index {first}; enlarge the domain, or leave it \
         out to take the bounds of the points"
    )]
    OutsideDomain {
        /// What was being read: "points".
        what: &'static str,
        /// How many lie outside.
        count: u64,
        /// Index of the first one.
        first: u64,
    },

    /// A radius that is negative, NaN, infinite, or whose square is not a normal f32.
    #[error("radius {radius:e}{} {reason}", .index.map(|i| format!(" of query {i}")).unwrap_or_default())]
    InvalidRadius {
        /// The radius asked for.
        radius: f32,
        /// The query it belongs to, where each query has its own.
        index: Option<u64>,
        /// Why it is refused.
        reason: &'static str,
    },

    /// A ray that cannot be cast.
    #[error("the ray{} {reason}", .index.map(|i| format!(" at index {i}")).unwrap_or_default())]
    InvalidRay {
        /// Its place, where there are many.
        index: Option<u64>,
        /// What is wrong with it.
        reason: &'static str,
    },

    /// A mesh without triangles where surfaces are needed.
    #[error("the mesh has {vertices} vertices and no triangles; rays hit triangles, so give a mesh with faces")]
    NoTriangles {
        /// Its vertices.
        vertices: u64,
    },

    /// Points without normals where the side of a surface is needed.
    #[error(
        "{without} of {points} points have no normal, the first at index {first}; estimate normals first (`nearfield normals`), \
         or drop those points"
    )]
    NoNormals {
        /// Number of points.
        points: u64,
        /// How many have no normal, or one without direction.
        without: u64,
        /// Index of the first one.
        first: u64,
    },

    /// A simulation that left what can be simulated.
    #[error(
        "step {step} left particle {particle} at {position:?} with speed {speed:e} (limit {limit:e}); use a shorter time step, softer forces \
         or a higher limit. The state before is kept"
    )]
    BlowUp {
        /// Number of the step.
        step: u64,
        /// Index of the first such particle in the scene.
        particle: u64,
        /// Where it is.
        position: [f64; 3],
        /// How fast it moves.
        speed: f64,
        /// The highest speed that is allowed.
        limit: f64,
    },

    /// A computation that its caller has ended.
    #[error("interrupted at {stage}, after {done} of {total}; start it again for the whole answer")]
    Interrupted {
        /// What was being done.
        stage: &'static str,
        /// How much of it was done.
        done: u64,
        /// How much there is to do.
        total: u64,
    },

    /// A setting outside its range.
    #[error("{setting} = {found} is not usable: expected {expected}")]
    InvalidSetting {
        /// Name of the setting.
        setting: &'static str,
        /// The value given.
        found: String,
        /// The values that are possible.
        expected: &'static str,
    },

    /// Two arrays that must have one length differ.
    #[error("{what} has {found} elements, expected {expected}")]
    LengthMismatch {
        /// The array that does not fit.
        what: &'static str,
        /// Its length.
        found: u64,
        /// The length it should have.
        expected: u64,
    },

    /// More elements than indices or a device binding can address.
    #[error("{what}: {found} asked for, at most {limit} possible; {advice}")]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// How many were asked for.
        found: u64,
        /// The largest possible number.
        limit: u64,
        /// What to do instead.
        advice: &'static str,
    },

    /// Host memory that could not be had, or would pass the limit the caller set.
    #[error(
        "{what} needs {needed} bytes of memory, {available} are allowed; use a smaller input, count instead of list, or raise the limit"
    )]
    OutOfMemory {
        /// What the memory was for.
        what: &'static str,
        /// Bytes needed.
        needed: u64,
        /// Bytes that may be used.
        available: u64,
    },

    /// A file that is not what it says it is.
    #[error(transparent)]
    File(#[from] Box<FileError>),

    /// No device of the kind asked for.
    #[error("no device matches {asked:?}; found: {}", if .found.is_empty() { "none".to_owned() } else { .found.join(", ") })]
    NoDevice {
        /// The choice as written by the caller.
        asked: String,
        /// Names of the devices there are.
        found: Vec<String>,
    },

    /// Device memory that could not be had.
    #[error(
        "device memory for {what}: {needed} bytes needed, {available} available; use fewer points, smaller batches or the CPU"
    )]
    OutOfDeviceMemory {
        /// The buffer that did not fit.
        what: String,
        /// Bytes needed.
        needed: u64,
        /// Bytes that may be allocated or bound at once.
        available: u64,
    },

    /// The device went away.
    #[error("device {device} was lost ({reason}); open it again and rebuild what lived on it")]
    DeviceLost {
        /// Name of the device.
        device: String,
        /// What the driver said.
        reason: String,
    },

    /// A kernel that could not be composed or compiled, most often a caller's own.
    #[error("kernel {kernel} was rejected: {message}")]
    KernelRejected {
        /// Module path of the kernel.
        kernel: String,
        /// The compiler's message.
        message: String,
    },

    /// The device refused an operation.
    #[error("device operation {operation} failed: {message}")]
    Device {
        /// What was being done.
        operation: String,
        /// What the driver said.
        message: String,
    },

    /// The input or output itself failed.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },

    /// Something this structure or device cannot do.
    #[error("{what} is not supported: {advice}")]
    Unsupported {
        /// What was asked for.
        what: String,
        /// What to do instead.
        advice: &'static str,
    },
}

impl Error {
    /// Whether another device might succeed where this one failed.
    pub fn is_device_fault(&self) -> bool {
        matches!(
            self,
            Self::OutOfDeviceMemory { .. }
                | Self::DeviceLost { .. }
                | Self::Device { .. }
                | Self::KernelRejected { .. }
        )
    }
}

/// A malformed file: where, what was found, what was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}{}: {format}: found {found}, expected {expected}", .path.as_ref().map_or("input".to_owned(), |p| p.display().to_string()), .place)]
pub struct FileError {
    /// The file, once known (readers work on bytes; the opener fills it in).
    pub path: Option<PathBuf>,
    /// Format name: "PLY", "PCD" …
    pub format: &'static str,
    /// Line, byte or element.
    pub place: Place,
    /// What stands there.
    pub found: String,
    /// What should stand there.
    pub expected: String,
}

/// A position in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// 1-based line of a text format.
    Line(u64),
    /// 0-based byte of a binary format.
    Byte(u64),
    /// The whole file.
    Whole,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Place::Line(n) => write!(f, ":{n}"),
            Place::Byte(n) => write!(f, " at byte {n}"),
            Place::Whole => Ok(()),
        }
    }
}

impl FileError {
    /// A file error without its path.
    pub fn new(format: &'static str, place: Place, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { path: None, format, place, found: found.into(), expected: expected.into() }
    }
}

impl From<FileError> for Error {
    fn from(error: FileError) -> Self {
        Error::File(Box::new(error))
    }
}
