//! A heap of points whose weights fall while they wait: the heaviest on top, of equals the one with the largest index.

/// Points 0 to n − 1 by weight.
pub(super) struct Heap {
    /// `[n]` weights of the points: whole numbers, so that what was added can be taken away again exactly.
    weights: Vec<u64>,
    /// Points, each no lighter than the two below it.
    order: Vec<u32>,
    /// `[n]` where each point stands in `order`; `GONE` once it was taken.
    places: Vec<u32>,
}

const GONE: u32 = u32::MAX;

impl Heap {
    /// All points with these weights.
    pub(super) fn of(weights: Vec<u64>) -> Self {
        let order: Vec<u32> = (0..weights.len() as u32).collect();
        let mut heap = Self { weights, places: order.clone(), order };
        (0..heap.order.len() / 2).rev().for_each(|place| heap.sink(place));
        heap
    }

    /// Number of points that wait.
    pub(super) fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether a point waits.
    pub(super) fn holds(&self, point: u32) -> bool {
        self.places[point as usize] != GONE
    }

    /// Takes the heaviest point.
    pub(super) fn pop(&mut self) -> Option<u32> {
        let last = self.order.pop()?;
        let top = self.order.first_mut().map_or(last, |first| std::mem::replace(first, last));
        self.places[top as usize] = GONE;
        if top != last {
            self.places[last as usize] = 0;
            self.sink(0);
        }
        Some(top)
    }

    /// Makes a point that waits lighter, by no more than it weighs.
    pub(super) fn lighten(&mut self, point: u32, by: u64) {
        self.weights[point as usize] -= by;
        self.sink(self.places[point as usize] as usize);
    }

    fn is_heavier(&self, a: u32, b: u32) -> bool {
        let (of_a, of_b) = (self.weights[a as usize], self.weights[b as usize]);
        of_a > of_b || (of_a == of_b && a > b)
    }

    fn sink(&mut self, mut place: usize) {
        loop {
            let children = [2 * place + 1, 2 * place + 2];
            let heaviest = children.into_iter().filter(|&child| child < self.order.len()).fold(place, |best, child| {
                if self.is_heavier(self.order[child], self.order[best]) { child } else { best }
            });
            if heaviest == place {
                return;
            }
            self.order.swap(place, heaviest);
            self.places[self.order[place] as usize] = place as u32;
            self.places[self.order[heaviest] as usize] = heaviest as u32;
            place = heaviest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_heaviest_comes_first_whatever_was_made_lighter() {
        let mut weights: Vec<u64> = (0..200).map(|i| 10_000 + i * 37 % 101).collect();
        let mut heap = Heap::of(weights.clone());
        let mut waits: Vec<u32> = (0..200).collect();
        for step in 0..200u32 {
            if let Some(&light) = waits.get(step as usize % waits.len()) {
                heap.lighten(light, 20);
                weights[light as usize] -= 20;
            }
            let key = |i: &u32| (weights[*i as usize], *i);
            let expected = waits.iter().copied().max_by_key(key).unwrap();
            assert_eq!(heap.len(), waits.len());
            assert_eq!(heap.pop(), Some(expected));
            assert!(!heap.holds(expected));
            waits.retain(|&i| i != expected && heap.holds(i));
        }
        assert_eq!(heap.pop(), None);
    }
}
