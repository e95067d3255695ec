//! From the binary tree to nodes of eight children, at least expected cost. Source: Ylitie2017 §3.1.
//!
//! A box is entered by a ray with a probability that grows with its surface. The least cost of a binary subtree as at most
//! i children of a wide node, for i from 1 to 7, follows from those of its halves; going down from the root along the best
//! choices gives the wide tree.

use super::build::BinaryNode;
use super::split::half_area;
use crate::geometry::Aabb;

/// Children of a wide node.
pub(super) const WIDTH: usize = 8;
/// Subtrees of fewer triangles are planned by one thread.
const PARALLEL: u32 = 1 << 12;

/// What a leaf costs.
#[derive(Debug, Clone, Copy)]
pub(super) struct LeafCost {
    /// Most triangles.
    pub(super) most: u32,
    /// Cost of entering it, in units of a node.
    pub(super) entry: f32,
    /// Cost of each triangle, in units of a node.
    pub(super) triangle: f32,
}

/// A child of a wide node.
#[derive(Debug, Clone, Copy)]
pub(super) struct WideChild {
    pub(super) bounds: Aabb,
    /// The node, or the first triangle in the order of the leaves.
    pub(super) first: u32,
    /// Triangles of a leaf; 0 for a node.
    pub(super) n_triangles: u32,
}

/// A node of up to eight children.
#[derive(Debug, Clone, Copy)]
pub(super) struct WideNode {
    pub(super) children: [WideChild; WIDTH],
    pub(super) n: usize,
}

impl WideNode {
    const NONE: Self = Self { children: [WideChild { bounds: Aabb::EMPTY, first: 0, n_triangles: 0 }; WIDTH], n: 0 };

    pub(super) fn children(&self) -> &[WideChild] {
        &self.children[..self.n]
    }
}

/// The wide tree: nodes, parents first, those of one parent side by side; and the nodes of its longest path.
pub(super) struct WideTree {
    pub(super) nodes: Vec<WideNode>,
    pub(super) depth: u32,
}

/// What is best for a binary subtree.
#[derive(Clone, Copy)]
struct Plan {
    /// `[i - 1]`: least cost as at most i children.
    costs: [f32; WIDTH - 1],
    /// `[i - 1]`: of i children, those that the left half gets; 0 where fewer than i are better.
    n_left: [u8; WIDTH],
    is_leaf: bool,
}

impl Plan {
    const NONE: Self = Self { costs: [f32::INFINITY; WIDTH - 1], n_left: [0; WIDTH], is_leaf: false };
}

/// Collapses a binary tree.
pub(super) fn collapse(binary: &[BinaryNode], cost: &LeafCost) -> WideTree {
    let mut plans = vec![Plan::NONE; binary.len()];
    let unit = 1.0 / half_area((binary[0].bounds.max - binary[0].bounds.min).into());
    plan(binary, &mut plans, cost, unit);
    let mut nodes = vec![WideNode::NONE];
    let mut depth = 1;
    // Of each node to be made: its place, its binary node, the first triangle below, the nodes above and itself.
    let mut pending = vec![(0, 0, 0, 1)];
    while let Some((place, root, first, level)) = pending.pop() {
        depth = depth.max(level);
        let mut roots = Roots::default();
        if binary[root].n_left == 0 {
            roots.push(root, first);
        } else {
            roots.share(binary, &plans, (root, first), WIDTH);
        }
        let mut node = WideNode::NONE;
        node.n = roots.n;
        for (child, &(root, first)) in node.children.iter_mut().zip(roots.as_slice()) {
            let below = &binary[root];
            *child = WideChild { bounds: below.bounds, first: first as u32, n_triangles: below.n };
            if !plans[root].is_leaf {
                (child.first, child.n_triangles) = (nodes.len() as u32, 0);
                pending.push((nodes.len(), root, first, level + 1));
                nodes.push(WideNode::NONE);
            }
        }
        nodes[place] = node;
    }
    WideTree { nodes, depth }
}

fn plan(binary: &[BinaryNode], plans: &mut [Plan], cost: &LeafCost, unit: f64) {
    let node = &binary[0];
    let area = (half_area((node.bounds.max - node.bounds.min).into()) * unit) as f32;
    let as_leaf = if node.n <= cost.most { area * (cost.entry + cost.triangle * node.n as f32) } else { f32::INFINITY };
    let (best, below) = plans.split_first_mut().expect("there should be a plan for every subtree");
    if node.n_left == 0 {
        *best = Plan { costs: [as_leaf; WIDTH - 1], n_left: [0; WIDTH], is_leaf: true };
        return;
    }
    let left_nodes = BinaryNode::count(node.n_left as usize);
    let (left, right) = below.split_at_mut(left_nodes);
    let (binary_left, binary_right) = binary[1..].split_at(left_nodes);
    if node.n > PARALLEL {
        rayon::join(|| plan(binary_left, left, cost, unit), || plan(binary_right, right, cost, unit));
    } else {
        plan(binary_left, left, cost, unit);
        plan(binary_right, right, cost, unit);
    }
    let (left, right) = (&left[0].costs, &right[0].costs);
    // Sharing out j children between the halves.
    let share = |j: usize| {
        let mut least = (f32::INFINITY, 1);
        for n_left in 1..j {
            let cost = left[n_left - 1] + right[j - n_left - 1];
            if cost < least.0 {
                least = (cost, n_left as u8);
            }
        }
        least
    };
    let (shared, n_left) = share(WIDTH);
    best.n_left[WIDTH - 1] = n_left;
    let as_node = area + shared;
    best.is_leaf = as_leaf <= as_node && node.n <= cost.most;
    best.costs[0] = if best.is_leaf { as_leaf } else { as_node };
    for i in 2..WIDTH {
        let (shared, n_left) = share(i);
        let is_better = shared < best.costs[i - 2];
        best.costs[i - 1] = if is_better { shared } else { best.costs[i - 2] };
        best.n_left[i - 1] = if is_better { n_left } else { 0 };
    }
}

/// The binary nodes that become children of a wide node, with the first triangle of each.
#[derive(Default)]
struct Roots {
    roots: [(usize, usize); WIDTH],
    n: usize,
}

impl Roots {
    fn push(&mut self, root: usize, first: usize) {
        self.roots[self.n] = (root, first);
        self.n += 1;
    }

    fn as_slice(&self) -> &[(usize, usize)] {
        &self.roots[..self.n]
    }

    /// Adds a subtree as at most `most` children.
    fn add(&mut self, binary: &[BinaryNode], plans: &[Plan], root: (usize, usize), most: usize) {
        let n_left = &plans[root.0].n_left;
        let most = (2..=most).rev().find(|&i| n_left[i - 1] > 0);
        match most {
            Some(most) if binary[root.0].n_left > 0 => self.share(binary, plans, root, most),
            _ => self.push(root.0, root.1),
        }
    }

    /// Shares out `most` children between the halves of a subtree.
    fn share(&mut self, binary: &[BinaryNode], plans: &[Plan], (root, first): (usize, usize), most: usize) {
        let n_left = binary[root].n_left as usize;
        let for_left = usize::from(plans[root].n_left[most - 1]);
        self.add(binary, plans, (root + 1, first), for_left);
        let right = root + 1 + BinaryNode::count(n_left);
        self.add(binary, plans, (right, first + n_left), most - for_left);
    }
}
