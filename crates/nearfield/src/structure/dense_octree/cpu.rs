//! The dense octree on the CPU.

use std::ops::Range;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::layout::level_and_key;
use super::{CellLayout, CellState, DenseOctreeSettings};
use crate::curve::{Curve, Domain, MAX_LEVEL, Octant};
use crate::geometry::{OrderedPoints, validate};
use crate::parallel::radix_sort;
use crate::structure::BuildStage;
use crate::{Error, Result};

/// Parents, cells or queries that one task takes at least.
const TASK: usize = 1 << 12;

/// Number of cells that are not in the tree.
pub(super) const NO_NUMBER: u32 = u32::MAX;

/// Points sorted along a curve under full arrays of cells, on the CPU.
///
/// ```
/// use nearfield::{CellState, DenseOctree, DenseOctreeSettings, Domain, Vec3};
///
/// let settings = DenseOctreeSettings::with_levels(2).domain(Domain::new(Vec3::ZERO, 4.0)?);
/// let tree = DenseOctree::build(&[Vec3::new(3.5, 1.5, 2.5)], &settings)?;
/// let leaf = tree.locate(&[Vec3::new(3.1, 1.2, 2.8)])?[0].expect("the place is inside");
/// assert_eq!((leaf.level(), leaf.key()), (2, 46)); // cell (3, 1, 2)
/// assert_eq!(tree.state_of(leaf), CellState::OccupiedLeaf);
/// assert_eq!(tree.n_nodes(), 17); // the root, its children, and the children of one of them
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct DenseOctree {
    pub(super) layout: CellLayout,
    pub(super) curve: Curve,
    pub(super) domain: Domain,
    pub(super) points: OrderedPoints,
    pub(super) starts: Vec<u32>,
    pub(super) states: Vec<CellState>,
    pub(super) nulls_before: Vec<u32>,
    pub(super) stages: Vec<BuildStage>,
}

impl DenseOctree {
    /// Sorts the points by the cell at the finest level, and prunes the cells from there up.
    ///
    /// # Errors
    /// `InvalidSetting` for more than eight levels; `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more);
    /// `OutsideDomain` where a domain is given and does not hold every point; `OutOfMemory`, before anything is
    /// allocated if the settings' limit would be passed.
    pub fn build(points: &[Vec3], settings: &DenseOctreeSettings) -> Result<Self> {
        let mut stages = Vec::new();
        let mut clock = Instant::now();
        let mut stage = |name| {
            stages.push(BuildStage::on_host(name, clock));
            clock = Instant::now();
        };
        let layout = settings.layout()?;
        let (needed, available) = (settings.bytes_on_cpu(layout, points.len()), settings.max_memory);
        if needed > available {
            return Err(Error::OutOfMemory { what: "a dense octree", needed, available });
        }
        let domain = settings.domain_of(points)?;
        stage("bounds");
        let (keys, order) = sorted_keys(points, &domain, settings.curve, layout)?;
        stage("sort");
        let points = OrderedPoints::gather(points, &order);
        stage("gather");
        let starts = cell_starts(&keys, layout)?;
        stage("starts");
        let states = pruned_states(&starts, layout)?;
        stage("prune");
        let nulls_before = nulls_before(&states)?;
        stage("count nulls");
        Ok(Self { layout, curve: settings.curve, domain, points, starts, states, nulls_before, stages })
    }

    /// Where cells stand in the arrays.
    pub fn layout(&self) -> CellLayout {
        self.layout
    }

    /// The order of the cells.
    pub fn curve(&self) -> Curve {
        self.curve
    }

    /// The cube that the root is.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// The points along the curve; those of one finest cell in the caller's order.
    pub fn points(&self) -> &OrderedPoints {
        &self.points
    }

    /// `[8^k + 1]` place of the first point of each cell of the finest level.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }

    /// `[cells of all levels]` states, in the order of [`CellLayout`].
    pub fn states(&self) -> &[CellState] {
        &self.states
    }

    /// `[8^level]` states of a level along the curve; empty for a level that is too fine.
    pub fn states_of(&self, level: u32) -> &[CellState] {
        &self.states[self.layout.level(level)]
    }

    /// What a cell is; null below the finest level.
    pub fn state_of(&self, cell: Octant) -> CellState {
        self.layout.place(cell).map_or(CellState::Null, |place| self.states[place])
    }

    /// `[cells of all levels + 1]` null cells before each place, and all of them.
    pub fn nulls_before(&self) -> &[u32] {
        &self.nulls_before
    }

    /// Nodes of the tree: cells that are not null.
    pub fn n_nodes(&self) -> usize {
        self.layout.cells() - self.nulls_before[self.layout.cells()] as usize
    }

    /// Places of the points in a cell, in [`DenseOctree::points`]; for a cell below the finest level, of those in the
    /// finest cell around it.
    pub fn points_in(&self, cell: Octant) -> Range<usize> {
        let levels = self.layout.levels();
        let finest = |c: Option<Octant>| c.map_or(0, |c| c.key() as usize);
        let (first, last) = match cell.ancestor(levels) {
            Some(around) => (around.key() as usize, around.key() as usize),
            None => (finest(cell.first_descendant(levels)), finest(cell.last_descendant(levels))),
        };
        self.starts[first] as usize..self.starts[last + 1] as usize
    }

    /// The leaf that holds each query, empty ones included; `None` for a query outside the domain.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`.
    pub fn locate(&self, queries: &[Vec3]) -> Result<Vec<Option<Octant>>> {
        validate::coordinates("queries", queries)?;
        let leaf = |query: &Vec3| {
            let inside = self.domain.contains(*query);
            inside.then(|| self.leaf_around(cell_key(&self.domain, self.curve, self.layout, *query)))
        };
        Ok(queries.par_iter().with_min_len(TASK).map(leaf).collect())
    }

    /// The leaf that holds a cell of the finest level: the first one up from it that is not null.
    fn leaf_around(&self, key: u32) -> Octant {
        let mut cell = self.layout.cell(self.layout.level(self.layout.levels()).start + key as usize);
        while self.state_of(cell) == CellState::Null {
            cell = cell.parent().expect("the root should not be null");
        }
        cell
    }

    /// Every leaf along the curve, empty ones included, with its state.
    pub fn leaves(&self) -> impl Iterator<Item = (Octant, CellState)> {
        let mut next = 0;
        std::iter::from_fn(move || {
            if next >= self.layout.finest() {
                return None;
            }
            let leaf = self.leaf_around(next as u32);
            next += 1 << (3 * (self.layout.levels() - leaf.level()));
            Some((leaf, self.state_of(leaf)))
        })
    }

    /// Number of a cell in the post-order walk of the tree, from 0; `None` for a cell that is null.
    ///
    /// Its number in the full tree, minus the null cells before it (Ajmera2008).
    pub fn post_order_number(&self, cell: Octant) -> Option<u32> {
        let place = self.layout.place(cell).filter(|&place| self.states[place] != CellState::Null)?;
        Some(self.number_at(place as u32, Walk::PostOrder))
    }

    /// Number of a cell in the pre-order walk of the tree, from 0; `None` for a cell that is null.
    pub fn pre_order_number(&self, cell: Octant) -> Option<u32> {
        let place = self.layout.place(cell).filter(|&place| self.states[place] != CellState::Null)?;
        Some(self.number_at(place as u32, Walk::PreOrder))
    }

    /// Number of each cell in the post-order walk `[cells of all levels]`; `u32::MAX` for cells that are null.
    pub fn post_order_numbers(&self) -> Vec<u32> {
        self.numbers(Walk::PostOrder)
    }

    /// Number of each cell in the pre-order walk `[cells of all levels]`; `u32::MAX` for cells that are null.
    pub fn pre_order_numbers(&self) -> Vec<u32> {
        self.numbers(Walk::PreOrder)
    }

    /// The nodes in post-order `[n_nodes]`: children before their parent.
    pub fn post_order(&self) -> Vec<(Octant, CellState)> {
        self.nodes(Walk::PostOrder)
    }

    /// The nodes in pre-order `[n_nodes]`: a parent before its children.
    pub fn pre_order(&self) -> Vec<(Octant, CellState)> {
        self.nodes(Walk::PreOrder)
    }

    fn number_at(&self, place: u32, walk: Walk) -> u32 {
        let (layout, (level, key)) = (self.layout, level_and_key(place));
        match walk {
            Walk::PostOrder => {
                let nulls = layout.nulls(&self.nulls_before, |of| layout.before_in_post_order(level, key, of));
                layout.full_post_order(level, key) - nulls
            }
            Walk::PreOrder => {
                let nulls = layout.nulls(&self.nulls_before, |of| layout.before_in_pre_order(level, key, of));
                layout.full_pre_order(level, key) - nulls
            }
        }
    }

    fn numbers(&self, walk: Walk) -> Vec<u32> {
        let number = |(place, &state): (usize, &CellState)| {
            if state == CellState::Null { NO_NUMBER } else { self.number_at(place as u32, walk) }
        };
        self.states.par_iter().enumerate().with_min_len(TASK).map(number).collect()
    }

    fn nodes(&self, walk: Walk) -> Vec<(Octant, CellState)> {
        let mut nodes = vec![(Octant::ROOT, CellState::Null); self.n_nodes()];
        for (place, number) in self.numbers(walk).into_iter().enumerate() {
            if number != NO_NUMBER {
                nodes[number as usize] = (self.layout.cell(place), self.states[place]);
            }
        }
        nodes
    }

    /// Times of the build.
    pub fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    /// Bytes held, points included.
    pub fn memory_bytes(&self) -> u64 {
        let words = self.starts.len() + self.nulls_before.len();
        self.points.memory_bytes() + 4 * words as u64 + self.states.len() as u64
    }
}

/// An order of the nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Walk {
    PostOrder,
    PreOrder,
}

/// Key of a point among the cells of the finest level.
#[inline]
pub(super) fn cell_key(domain: &Domain, curve: Curve, layout: CellLayout, point: Vec3) -> u32 {
    (domain.key_of(curve, point) >> (3 * (MAX_LEVEL - layout.levels()))) as u32
}

/// Keys of the points in ascending order, and the points' indices in that order, ties by index.
fn sorted_keys(points: &[Vec3], domain: &Domain, curve: Curve, layout: CellLayout) -> Result<(Vec<u32>, Vec<u32>)> {
    let key = |&point: &Vec3| cell_key(domain, curve, layout, point);
    let mut keys: Vec<u32> = points.par_iter().with_min_len(TASK).map(key).collect();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    radix_sort::sort_pairs(&mut keys, &mut order, 0..3 * layout.levels())?;
    Ok((keys, order))
}

/// An empty vector with room for `len` elements.
fn with_room<T>(what: &'static str, len: usize) -> Result<Vec<T>> {
    let mut values = Vec::new();
    let needed = (len * size_of::<T>()) as u64;
    values.try_reserve_exact(len).map_err(|_| Error::OutOfMemory { what, needed, available: 0 })?;
    Ok(values)
}

/// For each cell of the finest level the place of its first point, and the number of points at the end.
fn cell_starts(keys: &[u32], layout: CellLayout) -> Result<Vec<u32>> {
    let len = layout.finest() + 1;
    let mut starts = with_room("the starts of a dense octree's cells", len)?;
    for (place, &key) in keys.iter().enumerate() {
        if starts.len() <= key as usize {
            starts.resize(key as usize + 1, place as u32);
        }
    }
    starts.resize(len, keys.len() as u32);
    Ok(starts)
}

/// States of the cells of all levels: those of the finest by their points, the others from their eight children.
fn pruned_states(starts: &[u32], layout: CellLayout) -> Result<Vec<CellState>> {
    let mut states = with_room("the cells of a dense octree", layout.cells())?;
    states.resize(layout.cells(), CellState::Null);
    let finest = &mut states[layout.level(layout.levels())];
    finest.par_iter_mut().zip(starts.par_windows(2)).with_min_len(TASK).for_each(|(state, places)| {
        *state = if places[0] < places[1] { CellState::OccupiedLeaf } else { CellState::EmptyLeaf };
    });
    for level in (0..layout.levels()).rev() {
        let (coarser, finer) = states.split_at_mut(layout.level(level).end);
        let parents = coarser[layout.level(level)].par_iter_mut();
        let eights = finer[..layout.level(level + 1).len()].par_chunks_exact_mut(8);
        parents.zip(eights).with_min_len(TASK).for_each(|(parent, children)| {
            if children.iter().all(|&child| child == CellState::EmptyLeaf) {
                children.fill(CellState::Null);
                // A leaf, unless it is pruned in its turn.
                *parent = CellState::EmptyLeaf;
            } else {
                *parent = CellState::Inner;
            }
        });
    }
    Ok(states)
}

/// Null cells before each place, and all of them.
fn nulls_before(states: &[CellState]) -> Result<Vec<u32>> {
    let mut before = with_room("the null cells of a dense octree", states.len() + 1)?;
    let mut nulls = 0;
    before.extend(states.iter().map(|&state| {
        let here = nulls;
        nulls += u32::from(state == CellState::Null);
        here
    }));
    before.push(nulls);
    Ok(before)
}
