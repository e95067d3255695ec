//! An octree as arrays in an NPZ archive.

use std::path::Path;

use nearfield::OctreeNode;
use nearfield::io::{NpyArray, write_atomically, write_npz};

use crate::octree::Octree;

/// Writes the tree, whole or not at all.
pub(crate) fn write(path: &Path, octree: &Octree, force: bool) -> nearfield::Result<()> {
    let tree = &octree.tree;
    let words = |field: fn(&OctreeNode) -> u32| -> Vec<u32> { tree.nodes().iter().map(field).collect() };
    let bytes = |field: fn(&OctreeNode) -> u8| -> Vec<u8> { tree.nodes().iter().map(field).collect() };
    let octants: Vec<u64> = tree.nodes().iter().map(|node| node.octant.bits()).collect();
    // A level is at most 21, a mask has 8 bits.
    let (levels, masks) = (bytes(|node| node.level as u8), bytes(|node| node.child_mask as u8));
    let (first_points, end_points) = (words(|node| node.first_point), words(|node| node.end_point));
    let (parents, first_children) = (words(|node| node.parent), words(|node| node.first_child));
    let mut arrays = vec![
        ("octants", NpyArray::U64(&octants)),
        ("levels", NpyArray::U8(&levels)),
        ("first_points", NpyArray::U32(&first_points)),
        ("end_points", NpyArray::U32(&end_points)),
        ("parents", NpyArray::U32(&parents)),
        ("first_children", NpyArray::U32(&first_children)),
        ("child_masks", NpyArray::U8(&masks)),
        ("pre_order", NpyArray::U32(tree.pre_order_numbers())),
        ("post_order", NpyArray::U32(tree.post_order_numbers())),
        ("order", NpyArray::U32(tree.ordered_points().ids())),
    ];
    let parts = octree.split.as_ref().map(|split| split.partition.owners(&octree.cloud.points));
    if let Some(parts) = &parts {
        arrays.push(("part_of_point", NpyArray::U32(parts)));
    }
    write_atomically(path, force, |w| write_npz(&arrays, w))
}
