//! Options that several subcommands share, and the values they take.

use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;

use nearfield::geometry::Period;
use nearfield::io::Format;
use nearfield::{Aabb, DVec3, Vec3};

use crate::exit::Failure;
use crate::picture::Up;

/// Options of every subcommand.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Common {
    /// Say nothing but errors and what was asked for
    #[arg(long, short, global = true, help_heading = "General")]
    pub(crate) quiet: bool,

    /// Threads on the CPU [default: one a core]
    #[arg(long, value_name = "N", global = true, help_heading = "General")]
    pub(crate) threads: Option<NonZeroUsize>,

    /// Main memory that may be used, such as 8GiB or 500MB
    #[arg(long, value_name = "BYTES", global = true, help_heading = "General")]
    pub(crate) max_memory: Option<Bytes>,
}

impl Common {
    /// Sets up the threads; once a process.
    pub(crate) fn apply(&self) -> Result<(), Failure> {
        if let Some(threads) = self.threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.get());
            pool.build_global().map_err(|e| Failure::Usage(format!("--threads {threads}: {e}")))?;
        }
        Ok(())
    }

    /// Refuses work that would take more main memory than allowed.
    pub(crate) fn allow(&self, what: &'static str, needed: u64) -> nearfield::Result<()> {
        match self.max_memory {
            Some(Bytes(available)) if needed > available => {
                Err(nearfield::Error::OutOfMemory { what, needed, available })
            }
            _ => Ok(()),
        }
    }

    /// What is left of the memory limit after `used` bytes.
    pub(crate) fn memory_left(&self, used: u64) -> Option<u64> {
        self.max_memory.map(|Bytes(limit)| limit.saturating_sub(used))
    }

    /// Tells the user something, unless they want quiet.
    pub(crate) fn note(&self, text: &str) {
        if !self.quiet {
            eprintln!("nearfield: {text}");
        }
    }
}

/// A length in the unit of the file, or a part of the diagonal of the bounding box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Length {
    Absolute(f64),
    Percent(f64),
}

impl Length {
    /// The length for points with these bounds.
    pub(crate) fn within(self, bounds: &Aabb) -> f32 {
        match self {
            Self::Absolute(length) => length as f32,
            Self::Percent(_) if bounds.is_empty() => 0.0,
            Self::Percent(percent) => (percent / 100.0 * bounds.extent().as_dvec3().length()) as f32,
        }
    }
}

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "expected a length such as 0.25, or a part of the bounding-box diagonal such as 0.5%";
        let (number, kind): (_, fn(f64) -> Self) = match text.strip_suffix('%') {
            Some(number) => (number, Self::Percent),
            None => (text, Self::Absolute),
        };
        number.trim().parse().map(kind).map_err(|_| expected.to_owned())
    }
}

/// The deviation of noise, which may be 0.
pub(crate) fn deviation(noise: Length) -> Result<Length, Failure> {
    let (Length::Absolute(sigma) | Length::Percent(sigma)) = noise;
    if sigma >= 0.0 && sigma.is_finite() {
        return Ok(noise);
    }
    Err(Failure::Usage(format!("--noise {sigma}: expected a length of 0 or more")))
}

/// A number of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Bytes(pub(crate) u64);

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "expected bytes such as 8GiB, 500MB or 1048576".to_owned();
        let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
        let (number, unit) = text.split_at(digits);
        let unit = match unit.trim().to_ascii_lowercase().as_str() {
            "" | "b" => 1.0,
            "kb" => 1e3,
            "mb" => 1e6,
            "gb" => 1e9,
            "tb" => 1e12,
            "k" | "kib" => 1024.0,
            "m" | "mib" => 1024.0 * 1024.0,
            "g" | "gib" => 1024.0 * 1024.0 * 1024.0,
            "t" | "tib" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
            _ => return Err(expected()),
        };
        let number: f64 = number.parse().map_err(|_| expected())?;
        Ok(Self((number * unit) as u64))
    }
}

/// A number of elements; `1e6` and `1_000_000` are as good as 1000000.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Amount(pub(crate) usize);

impl FromStr for Amount {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let plain = text.replace('_', "");
        if let Ok(number) = plain.parse() {
            return Ok(Self(number));
        }
        match plain.parse::<f64>() {
            // Above 2^53 the text may have said another number than the one it parses to.
            Ok(number) if number >= 0.0 && number.fract() == 0.0 && number < 9e15 => Ok(Self(number as usize)),
            _ => Err("expected a whole number such as 100000 or 1e6".to_owned()),
        }
    }
}

/// Three periods, 0 for an axis without.
pub(crate) fn period(text: &str) -> Result<Period, String> {
    let lengths: Vec<f32> = text.split(',').filter_map(|t| t.trim().parse().ok()).collect();
    let [x, y, z] = lengths[..] else {
        return Err("expected three lengths X,Y,Z, 0 for an axis that is not periodic".to_owned());
    };
    if text.split(',').count() != 3 {
        return Err("expected three lengths X,Y,Z, 0 for an axis that is not periodic".to_owned());
    }
    Period::new(Vec3::new(x, y, z)).map_err(|e| e.to_string())
}

/// A place in the coordinates of a file.
pub(crate) fn place(text: &str) -> Result<DVec3, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|t| t.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) if [x, y, z].iter().all(|c| c.is_finite()) => Ok(DVec3::new(x, y, z)),
        _ => Err("expected three finite coordinates X,Y,Z in the unit of the file".to_owned()),
    }
}

/// Width and height of a picture in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PictureSize {
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl fmt::Display for PictureSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for PictureSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |t: &str| t.parse().ok().filter(|side| (200..=8000).contains(side));
        let sides = text.split_once(['x', 'X']).and_then(|(w, h)| Some((side(w)?, side(h)?)));
        let (width, height) = sides.ok_or("expected WIDTHxHEIGHT, each 200 to 8000, such as 1600x1000")?;
        Ok(Self { width, height })
    }
}

/// How a picture is drawn, of commands that draw one with `--picture`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct Framing {
    /// Width and height of the picture in pixels [default: 1600x1000; 1600x900 where two clouds stand side by side]
    #[arg(long, value_name = "WxH", requires = "picture")]
    picture_size: Option<PictureSize>,

    /// The direction that is up in the picture [default: guessed from the shape]
    #[arg(long, value_name = "AXIS", requires = "picture")]
    pub(crate) up: Option<Up>,
}

impl Framing {
    /// Of a picture of one cloud.
    pub(crate) fn size(&self) -> PictureSize {
        self.picture_size.unwrap_or(PictureSize { width: 1600, height: 1000 })
    }

    /// Of a picture of two clouds side by side.
    pub(crate) fn size_for_two(&self) -> PictureSize {
        self.picture_size.unwrap_or(PictureSize { width: 1600, height: 900 })
    }
}

/// Formats of what is read and of the cloud that is written.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct Formats {
    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    pub(crate) format: Option<Format>,

    /// Format of the output, where its extension does not say it
    #[arg(long, value_name = "F")]
    pub(crate) to: Option<Format>,

    /// Write PLY as text
    #[arg(long)]
    pub(crate) ascii: bool,
}

/// Options of commands that write a cloud made of another.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct CloudOptions {
    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    pub(crate) drop_invalid: bool,

    /// Print everything as one JSON object
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) formats: Formats,

    /// Replace files that exist
    #[arg(long)]
    pub(crate) force: bool,
}

/// Options of commands that sum up what they found in a cloud, and write one where that is asked for with `--output`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct SummaryOptions {
    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    pub(crate) drop_invalid: bool,

    /// Print the summary as one JSON object
    #[arg(long)]
    pub(crate) json: bool,

    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    pub(crate) format: Option<Format>,

    /// Format of the output, where its extension does not say it
    #[arg(long, value_name = "F", requires = "output")]
    pub(crate) to: Option<Format>,

    /// Write PLY as text
    #[arg(long, requires = "output")]
    pub(crate) ascii: bool,

    /// Replace files that exist
    #[arg(long)]
    pub(crate) force: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_is_of_the_diagonal() {
        let bounds = Aabb::new(Vec3::ZERO, Vec3::new(3.0, 4.0, 12.0)); // diagonal 13
        assert_eq!("10%".parse::<Length>().unwrap().within(&bounds), 1.3);
        assert_eq!("0.25".parse::<Length>().unwrap().within(&bounds), 0.25);
        assert_eq!("5%".parse::<Length>().unwrap().within(&Aabb::EMPTY), 0.0);
        assert!("5m".parse::<Length>().is_err());
    }

    #[test]
    fn bytes_have_units() {
        for (text, bytes) in [("8GiB", 8u64 << 30), ("500MB", 500_000_000), ("1.5kib", 1536), ("7", 7)] {
            assert_eq!(text.parse::<Bytes>(), Ok(Bytes(bytes)), "{text}");
        }
        assert!("8 apples".parse::<Bytes>().is_err() && "GiB".parse::<Bytes>().is_err());
    }

    #[test]
    fn amounts_are_whole() {
        assert_eq!("1e6".parse(), Ok(Amount(1_000_000)));
        assert_eq!("1_000".parse(), Ok(Amount(1000)));
        for text in ["1.5", "-1", "many", "1e300", "nan"] {
            assert!(text.parse::<Amount>().is_err(), "{text}");
        }
    }

    #[test]
    fn periods_are_three() {
        assert_eq!(period("1,0,2.5").unwrap().lengths(), Vec3::new(1.0, 0.0, 2.5));
        for text in ["1,2", "1,2,3,x", "1,2,-3", "a,b,c"] {
            assert!(period(text).is_err(), "{text}");
        }
    }

    #[test]
    fn places_are_three_finite_numbers() {
        assert_eq!(place("637000.125, -3,1e-3"), Ok(DVec3::new(637_000.125, -3.0, 1e-3)));
        for text in ["1,2", "1,2,3,4", "1,2,x", "1,2,nan", "1,2,inf", ""] {
            assert!(place(text).is_err(), "{text}");
        }
    }

    #[test]
    fn picture_sizes_have_limits() {
        assert_eq!("640x480".parse(), Ok(PictureSize { width: 640, height: 480 }));
        assert_eq!(PictureSize { width: 640, height: 480 }.to_string(), "640x480");
        assert!("640".parse::<PictureSize>().is_err() && "0x9".parse::<PictureSize>().is_err());
    }
}
