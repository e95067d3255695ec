//! Names of the synthetic sets, as enums that parse and print.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// Makes an enum whose variants parse from and print as the given names.
macro_rules! named_kinds {
    ($(#[$doc:meta])* $kind:ident, $setting:literal, $($(#[$variant_doc:meta])* $variant:ident = $name:literal),+ $(,)?) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum $kind {
            $($(#[$variant_doc])* $variant,)+
        }

        impl $kind {
            /// Every kind, in the order of the documentation.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// The name it parses from and prints as.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }
        }

        impl fmt::Display for $kind {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }

        impl FromStr for $kind {
            type Err = Error;

            fn from_str(text: &str) -> Result<Self, Error> {
                Self::ALL.iter().copied().find(|kind| kind.name() == text).ok_or_else(|| Error::InvalidSetting {
                    setting: $setting,
                    found: text.to_owned(),
                    expected: concat!("one of", $(" ", $name),+),
                })
            }
        }
    };
}

named_kinds! {
    /// What a synthetic cloud looks like.
    CloudKind, "kind of cloud",
    /// Uniform in the unit cube [0, 1)³.
    Uniform = "uniform",
    /// On the unit sphere, with Gaussian noise of 0.001 along the normal.
    Shell = "shell",
    /// In and around the unit cube: 100 Gaussian blobs of equal weight whose standard deviations are log-uniform in
    /// 10^-3.2 … 10^-1, over 10 % of uniform background.
    Clustered = "clustered",
    /// Plummer sphere of scale radius 1 about zero, cut off at radius 10 (Plummer1911).
    Plummer = "plummer",
    /// A car's scan of a street in metres: 64 rings from +2° to -24.8°, at most 2,000 columns a turn, range 120,
    /// noise 0.02, ground at z = 0, boxes for houses and cars. Turns follow each other 1 m apart along x.
    Lidar = "lidar",
    /// Uniform on the surface of the torus about the z axis with radii 1 and 0.4.
    Torus = "torus",
    /// An airborne scan of fractal hills, in metres, at map coordinates: 4 points a square metre, row by row.
    Terrain = "terrain",
    /// Every point at (0.25, 0.5, 0.75).
    AllEqual = "all-equal",
    /// Uniform on the segment from (0, 0.5, 0.25) along x, of length 1.
    Line = "line",
    /// Cubic lattice of spacing [`LATTICE_SPACING`](super::LATTICE_SPACING), x fastest: all coordinates and their
    /// squares are exact, so distances equal to a radius are exact ties.
    Lattice = "lattice",
}

named_kinds! {
    /// What a synthetic mesh looks like. Closed meshes have outward normals and share their vertices.
    MeshKind, "kind of mesh",
    /// Unit sphere, an icosahedron whose faces are split evenly: 20·f² triangles for the f ≥ 1 nearest to n.
    Icosphere = "icosphere",
    /// Unit cube [0, 1]³: 12·k² triangles for the k ≥ 1 nearest to n.
    Cube = "cube",
    /// Torus about the z axis with radii 1 and 0.4: 5·k² triangles or so, for k ≥ 3.
    Torus = "torus-mesh",
    /// The Cornell box in millimetres with its two blocks and its lamp, coloured, open to the front: 32·k² triangles.
    Cornell = "cornell",
    /// n separate random triangles in and around the unit cube, about n^(-1/3) wide.
    Soup = "soup",
}
