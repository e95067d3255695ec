//! What must have given an answer: structure, device, search and kernels, as reports name them.

use nearfield::Report;

#[cfg(feature = "gpu")]
use super::device;
use super::{Device, Subject};
use crate::compare::Verdict;

#[cfg(feature = "gpu")]
const FIND_PAIRS: &str = "package::structure::uniform_grid::find_pairs";
#[cfg(feature = "gpu")]
const FILL_OVERFLOWED: &str = "package::query::fill_overflowed";

/// What an answer was made for: it decides which search and kernels must have run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asked {
    Count,
    List { sorted: bool, distances: bool },
    CappedList,
    Nearest,
    Knn,
    Boxes,
}

impl Subject {
    /// Checks that this subject with this search and these kernels, and nothing else, gave an answer.
    pub(crate) fn check_report(&self, report: &Report, asked: Asked) -> Verdict {
        let (device_is_right, search, kernels) = match self.device {
            Device::Cpu => {
                let search = match self.structure {
                    "brute-force" => "all-pairs",
                    "linear-octree" if asked == Asked::Knn => "nearest-octants",
                    "linear-octree" => "octants",
                    "aabb-tree" if asked == Asked::Knn => "nearest-boxes",
                    "aabb-tree" => self.variant.split(' ').next().expect("a variant should have a word"),
                    _ => "row-runs",
                };
                let kernels: &[&str] = match asked {
                    Asked::Count => &["row_simd::count"],
                    Asked::List { .. } => &["row_simd::mark", "row_simd::collect_marked"],
                    Asked::CappedList | Asked::Nearest | Asked::Knn => &["row_simd::collect"],
                    Asked::Boxes => &["boxes"],
                };
                (report.device.starts_with("cpu ("), search, kernels.iter().map(|&kernel| kernel.to_owned()).collect())
            }
            #[cfg(feature = "gpu")]
            Device::Gpu => {
                let in_pairs = report.kernels.first().is_some_and(|k| k == FIND_PAIRS);
                let (search, mut kernels) = if in_pairs { self.in_pairs(asked) } else { self.on_gpu(asked) };
                // Rows with more words than the masks hold need one kernel more.
                let overflowed =
                    if in_pairs { format!("{FIND_PAIRS} for long rows") } else { FILL_OVERFLOWED.to_owned() };
                if search == "row-masks" && report.kernels.contains(&overflowed) {
                    kernels.push(overflowed);
                }
                // Packs go before where the question suits them.
                let packs = "package::query::knn_packs";
                if search == "nearest-boxes" && report.kernels.iter().any(|k| k == packs) {
                    kernels.insert(0, packs.to_owned());
                }
                (report.device == device().name(), search, kernels)
            }
        };
        let right = report.structure == self.structure
            && report.search == search
            && device_is_right
            && report.kernels == kernels;
        if right || self.is_by_the_host(report, asked) {
            return Ok(());
        }
        Err(format!("{} was asked, expected {search} by {kernels:?}, the report says {report:?}", self.name()))
    }

    /// Whether the host ordered or cut rows, which it does only for devices that end long loops, and says so.
    #[cfg(feature = "gpu")]
    fn is_by_the_host(&self, report: &Report, asked: Asked) -> bool {
        let asked = self.answered_as(asked);
        let is_ordered = matches!(asked, Asked::CappedList | Asked::List { sorted: true, .. });
        let said = report.notes.iter().any(|note| note.contains("the host"));
        // The device may still sort rows that the host only cuts.
        let (search, kernels) = self.on_gpu(Asked::List { sorted: false, distances: true });
        let (_, sorting) = self.on_gpu(Asked::List { sorted: true, distances: true });
        let is_sorted_on_device = asked == Asked::CappedList && report.kernels == sorting;
        self.device == Device::Gpu
            && device().limits().loop_rounds.is_some()
            && is_ordered
            && said
            && report.structure == self.structure
            && report.search == search
            && report.device == device().name()
            && (report.kernels == kernels || is_sorted_on_device)
    }

    #[cfg(not(feature = "gpu"))]
    fn is_by_the_host(&self, _: &Report, _: Asked) -> bool {
        false
    }

    /// Brute force on a device has no search of its own for the nearest: it cuts lists.
    #[cfg(feature = "gpu")]
    fn answered_as(&self, asked: Asked) -> Asked {
        if asked == Asked::Knn && self.structure == "brute-force" { Asked::CappedList } else { asked }
    }

    /// The same where the points of a grid are searched in pairs, which is for counts, for lists by masks and for the nearest only.
    #[cfg(feature = "gpu")]
    fn in_pairs(&self, asked: Asked) -> (&'static str, Vec<String>) {
        match asked {
            Asked::Count if self.structure == "uniform-grid" => ("thread-a-pair", vec![FIND_PAIRS.to_owned()]),
            Asked::List { sorted: false, distances: false } if self.structure == "uniform-grid" => {
                ("row-masks", vec![FIND_PAIRS.to_owned(), "package::query::expand_pairs".to_owned()])
            }
            Asked::Knn if self.structure == "uniform-grid" => {
                let kernels = [FIND_PAIRS, "package::query::knn_pairs", "package::query::knn_widening"];
                ("nearest-cells", kernels.map(str::to_owned).to_vec())
            }
            _ => ("no search in pairs", vec![]),
        }
    }

    /// The search and the kernels that answer on a device.
    #[cfg(feature = "gpu")]
    fn on_gpu(&self, asked: Asked) -> (&'static str, Vec<String>) {
        let asked = self.answered_as(asked);
        match asked {
            Asked::Knn if self.structure == "aabb-tree" => {
                return ("nearest-boxes", vec!["package::query::knn_boxes".to_owned()]);
            }
            Asked::Knn if self.structure == "uniform-grid" => {
                return ("nearest-cells", vec!["package::query::knn_widening".to_owned()]);
            }
            Asked::Knn => return ("nearest-octants", vec!["package::query::knn".to_owned()]),
            Asked::Boxes => return ("thread-a-box", vec!["package::query::boxes".to_owned()]),
            _ => {}
        }
        let plain = asked == (Asked::List { sorted: false, distances: false });
        let coherent = self.variant == "coherent";
        if coherent && plain {
            let kernel = |name: &str| format!("package::query::coherent::{name}");
            return ("coherent", ["pack", "back_traverse", "extract"].map(kernel).to_vec());
        }
        let by_masks = self.structure != "brute-force" && plain;
        let (search, visitors): (_, &[&str]) = match asked {
            Asked::Count => ("thread-a-query", &["count"]),
            Asked::List { .. } if by_masks => ("row-masks", &["row_masks"]),
            Asked::List { .. } => ("two-pass", &["count", "fill"]),
            Asked::CappedList => ("nearest-k", &["nearest_k"]),
            Asked::Nearest | Asked::Knn | Asked::Boxes => ("thread-a-query", &["nearest"]),
        };
        let mut traverse = format!("package::structure::{}::traverse", self.structure.replace('-', "_"));
        let (mut search, mut kernels) = (search, Vec::new());
        if coherent {
            (search, traverse) = ("coherent", "package::query::coherent::candidates".to_owned());
            kernels = ["pack", "back_traverse"].map(|name| format!("package::query::coherent::{name}")).to_vec();
        }
        let kernel = |v: &&str| format!("package::query::fixed_radius with {traverse} and package::query::{v}");
        kernels.extend(visitors.iter().map(kernel));
        match asked {
            Asked::List { .. } if by_masks => kernels.push("package::query::expand_masks".into()),
            Asked::List { sorted: true, .. } => kernels.push("package::query::sort_rows".into()),
            _ => {}
        }
        (search, kernels)
    }
}
