//! From the binary tree to nodes of eight children, at least expected cost. Source: Ylitie2017 §3.1.
//!
//! A box is entered by a ray with a probability that grows with its surface. The least cost of a binary subtree as at most
//! i children of a wide node, for i from 1 to 7, follows from those of its halves, as soon as these are built; going down from
//! the root along the best choices gives the wide tree.

use bytemuck::Zeroable;

use super::build::BinaryTree;
use crate::geometry::Aabb;

/// Children of a wide node.
pub(super) const WIDTH: usize = 8;

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

/// `[i - 1]`: the least cost of a binary subtree as at most i children of a wide node.
#[derive(Debug, Clone, Copy)]
pub(super) struct Costs([f32; WIDTH - 1]);

impl Costs {
    /// Of a single triangle in a box with this area.
    #[inline(always)]
    pub(super) fn of_triangle(cost: &LeafCost, area: f32) -> Self {
        Self([area * (cost.entry + cost.triangle); WIDTH - 1])
    }
}

/// `[i - 1]`: of a binary subtree's i children of a wide node, those that the left half gets; 0 where fewer than i are as good.
/// The first one says instead whether one child is best a leaf.
#[derive(Debug, Clone, Copy, Zeroable)]
#[repr(transparent)]
pub(super) struct Shares([u8; WIDTH]);

impl Shares {
    fn is_leaf(&self) -> bool {
        self.0[0] != 0
    }
}

impl LeafCost {
    /// What is best for a subtree whose box has this area, given the costs of its halves and their triangles.
    #[inline(always)]
    pub(super) fn share(
        &self,
        (left, n_left): (&Costs, usize),
        (right, n_right): (&Costs, usize),
        area: f32,
    ) -> (Costs, Shares) {
        let n = n_left + n_right;
        // Sharing out i children between the halves, neither of which is more than its triangles.
        let share = |i: usize| {
            let mut least = (f32::INFINITY, 1);
            for n_first in i.saturating_sub(n_right).max(1)..=(i - 1).min(n_left) {
                let cost = left.0[n_first - 1] + right.0[i - n_first - 1];
                if cost < least.0 {
                    least = (cost, n_first as u8);
                }
            }
            least
        };
        let mut shares = [0; WIDTH];
        let (shared, most_left) = share(WIDTH.min(n));
        shares[WIDTH - 1] = most_left;
        let as_node = area + shared;
        let as_leaf =
            if n <= self.most as usize { area * (self.entry + self.triangle * n as f32) } else { f32::INFINITY };
        shares[0] = u8::from(as_leaf <= as_node && n <= self.most as usize);
        let mut costs = [as_leaf.min(as_node); WIDTH - 1];
        for i in 2..WIDTH {
            costs[i - 1] = costs[i - 2];
            if i <= n {
                let (shared, n_first) = share(i);
                if shared < costs[i - 2] {
                    (costs[i - 1], shares[i - 1]) = (shared, n_first);
                }
            }
        }
        (Costs(costs), Shares(shares))
    }
}

/// Collapses a binary tree.
pub(super) fn collapse(binary: &BinaryTree) -> WideTree {
    let mut nodes = vec![WideNode::NONE];
    let mut depth = 1;
    // Of each node to be made: its place, its binary subtree, the nodes above and itself.
    let mut pending = vec![(0, Root { node: 0, first: 0, n: binary.primitives.len() as u32 }, 1)];
    while let Some((place, root, level)) = pending.pop() {
        depth = depth.max(level);
        let mut roots = Roots::default();
        if root.n == 1 {
            roots.push(root);
        } else {
            roots.share(binary, root, WIDTH);
        }
        let mut node = WideNode::NONE;
        node.n = roots.n;
        for (child, &root) in node.children.iter_mut().zip(roots.as_slice()) {
            let (bounds, is_leaf) = if root.n == 1 {
                (binary.primitives[root.first as usize].bounds(), true)
            } else {
                let below = &binary.nodes[root.node as usize];
                (below.bounds, below.shares.is_leaf())
            };
            *child = WideChild { bounds, first: root.first, n_triangles: root.n };
            if !is_leaf {
                (child.first, child.n_triangles) = (nodes.len() as u32, 0);
                pending.push((nodes.len(), root, level + 1));
                nodes.push(WideNode::NONE);
            }
        }
        nodes[place] = node;
    }
    WideTree { nodes, depth }
}

/// A binary subtree.
#[derive(Default, Clone, Copy)]
struct Root {
    /// Its node, where it has more than one triangle.
    node: u32,
    /// The first triangle below, in the order of the leaves.
    first: u32,
    n: u32,
}

/// The binary subtrees that become children of a wide node.
#[derive(Default)]
struct Roots {
    roots: [Root; WIDTH],
    n: usize,
}

impl Roots {
    fn push(&mut self, root: Root) {
        self.roots[self.n] = root;
        self.n += 1;
    }

    fn as_slice(&self) -> &[Root] {
        &self.roots[..self.n]
    }

    /// Adds a subtree as at most `most` children.
    fn add(&mut self, binary: &BinaryTree, root: Root, most: usize) {
        if root.n > 1 {
            let shares = &binary.nodes[root.node as usize].shares;
            if let Some(most) = (2..=most).rev().find(|&i| shares.0[i - 1] > 0) {
                return self.share(binary, root, most);
            }
        }
        self.push(root);
    }

    /// Shares out `most` children between the halves of a subtree.
    fn share(&mut self, binary: &BinaryTree, root: Root, most: usize) {
        let node = &binary.nodes[root.node as usize];
        let for_left = usize::from(node.shares.0[most - 1]);
        let left = Root { node: root.node + 1, first: root.first, n: node.n_left };
        let right = Root { node: root.node + node.n_left, first: root.first + node.n_left, n: root.n - node.n_left };
        self.add(binary, left, for_left);
        self.add(binary, right, most - for_left);
    }
}
