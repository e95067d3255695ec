//! The invariants of the octree as code; the numbers are those of the module's page.

use super::LinearOctree;
use super::layout::NONE;
use crate::curve::Octant;
use crate::structure::CpuStructure;

impl LinearOctree {
    /// The first broken invariant, in words; `None` for a sound tree. For tests and for debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        self.broken_points()
            .or_else(|| self.broken_nodes())
            .or_else(|| self.broken_orders())
            .or_else(|| self.broken_packs())
    }

    fn broken_points(&self) -> Option<String> {
        let n = self.points.len();
        let mut seen = vec![false; n];
        for i in 0..n {
            let id = self.points.id(i) as usize;
            if id >= n || std::mem::replace(&mut seen[id], true) {
                return Some(format!("1: index {id} at place {i} is out of range or stands twice"));
            }
            if i > 0 && (self.key_at(i - 1), self.points.id(i - 1)) >= (self.key_at(i), self.points.id(i)) {
                return Some(format!("1: places {} and {i} are not in order", i - 1));
            }
        }
        let mut place = 0;
        for leaf in self.leaves() {
            let node = &self.nodes()[leaf as usize];
            if node.first_point != place || node.end_point <= place {
                return Some(format!("2: leaf {leaf} has points {:?}, expected to start at {place}", node.points()));
            }
            place = node.end_point;
            let outside = |i: &usize| {
                let key = self.domain().key_of(self.curve(), self.points.position(*i));
                !node.octant.contains(Octant::of_key(key, crate::curve::MAX_LEVEL))
            };
            if let Some(i) = node.points().find(outside) {
                return Some(format!("2: point at place {i} is not in its leaf {leaf}"));
            }
        }
        (place as usize != n).then(|| format!("2: leaves end at {place} of {n} points"))
    }

    fn broken_nodes(&self) -> Option<String> {
        let (nodes, capacity) = (self.nodes(), self.settings.leaf_capacity);
        let depth = self.settings.max_level;
        for (i, node) in nodes.iter().enumerate() {
            let too_many = node.n_points() > capacity;
            if node.level > depth
                || (node.is_leaf() && node.level < depth && too_many)
                || (!node.is_leaf() && !too_many && !self.is_balanced)
            {
                return Some(format!("3: node {i} at level {} holds {} points", node.level, node.n_points()));
            }
            if node.octant.level() != node.level || node.low != node.octant.cell_range(self.curve())[0] {
                return Some(format!("5: node {i} does not lie where its octant {:?} is", node.octant));
            }
            if i > 0 && (nodes[i - 1].level, nodes[i - 1].octant) >= (node.level, node.octant) {
                return Some(format!("4: nodes {} and {i} are not in order", i - 1));
            }
            if let Some(broken) = self.broken_links(i) {
                return Some(broken);
            }
        }
        let levels = (0..self.n_levels() as u32).map(|level| self.level(level));
        let wrong =
            levels.enumerate().find(|(level, range)| nodes[range.clone()].iter().any(|n| n.level as usize != *level));
        wrong.map(|(level, _)| format!("4: the range of level {level} holds other nodes"))
    }

    fn broken_links(&self, i: usize) -> Option<String> {
        let (nodes, node) = (self.nodes(), &self.nodes()[i]);
        let parent = nodes.get(node.parent as usize);
        if parent.map(|p| p.octant) != node.octant.parent() || (parent.is_none() && node.parent != NONE) {
            return Some(format!("5: node {i} names {} as its parent", node.parent));
        }
        let children = node.children();
        let mask = children.clone().fold(0, |mask, c| mask | 1u32 << nodes[c].octant.child_index());
        if mask != node.child_mask || children.clone().any(|c| nodes[c].parent as usize != i) {
            return Some(format!("5: node {i} and its children {children:?} disagree"));
        }
        if !children.is_empty() {
            let starts = children.clone().map(|c| nodes[c].first_point).chain([node.end_point]);
            let ends = [node.first_point].into_iter().chain(children.clone().map(|c| nodes[c].end_point));
            if !starts.eq(ends) {
                return Some(format!("5: the children of node {i} do not tile its points {:?}", node.points()));
            }
        }
        let follows = nodes.get(node.rope as usize);
        let expected_rope = match (parent, node.octant.next()) {
            (None, _) => None,
            (Some(parent), _) if i + 1 < parent.children().end => Some(i as u32 + 1),
            (Some(parent), _) => Some(parent.rope),
        };
        if follows.map(|_| node.rope) != expected_rope.filter(|&rope| rope != NONE) {
            return Some(format!("5: node {i} has the rope {}, expected {expected_rope:?}", node.rope));
        }
        None
    }

    fn broken_orders(&self) -> Option<String> {
        let n = self.nodes().len();
        for (name, numbers) in [("pre-order", self.pre_order_numbers()), ("post-order", self.post_order_numbers())] {
            let mut seen = vec![false; n];
            let once = |&number: &u32| (number as usize) < n && !std::mem::replace(&mut seen[number as usize], true);
            if numbers.len() != n || !numbers.iter().all(once) {
                return Some(format!("6: {name} is not a permutation of {n} nodes"));
            }
        }
        let (pre, post) = (self.pre_order_numbers(), self.post_order_numbers());
        let wrong = self.nodes().iter().enumerate().skip(1).find(|(i, node)| {
            let parent = node.parent as usize;
            pre[parent] >= pre[*i] || post[parent] <= post[*i]
        });
        if let Some((i, _)) = wrong {
            return Some(format!("6: node {i} and its parent are in the wrong order"));
        }
        let along = |numbers: &[u32]| {
            self.nodes()
                .windows(2)
                .enumerate()
                .find(|(i, w)| w[0].level == w[1].level && numbers[*i] >= numbers[i + 1])
                .map(|(i, _)| i)
        };
        along(pre).or_else(|| along(post)).map(|i| format!("6: nodes {i} and {} are in the wrong order", i + 1))
    }

    fn broken_packs(&self) -> Option<String> {
        let (packs, n) = (self.packs(), self.points.len() as u32);
        let sound = packs.last() == Some(&n) && (n == 0 || packs[0] == 0) && packs.is_sorted_by(|a, b| a < b);
        (!sound).then(|| "packs are not ascending from 0 to n".to_owned())
    }
}
