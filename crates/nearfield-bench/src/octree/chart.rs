//! The charts of the poster.

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Chart {
    Curve,
    Octree,
    PostOrder,
    NearNeighbors,
    Locations,
}

impl Chart {
    pub(super) const ALL: [Self; 5] =
        [Self::Curve, Self::Octree, Self::PostOrder, Self::NearNeighbors, Self::Locations];

    pub(super) fn title(self) -> &'static str {
        match self {
            Self::Curve => "curve construction",
            Self::Octree => "octree construction",
            Self::PostOrder => "post-order traversal",
            Self::NearNeighbors => "near neighbours of n points",
            Self::Locations => "locations of n points",
        }
    }
}
