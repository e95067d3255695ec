//! `nearfield octree`: its table, its parts, its files and its pictures, on the CPU and on the GPU.

use std::fs;

use serde_json::{Value, json};

use crate::neighbors::{npz_arrays, png_pixels};
use crate::{Folder, gpu_or_skip, png_size};

/// Eight points, one in each octant of a cube of edge 8 in map coordinates, and a ninth beside the first.
fn corners() -> String {
    let corner = |i: u32| {
        let [x, y, z] = [i >> 2, i >> 1 & 1, i & 1].map(|bit| f64::from(bit) * 8.0);
        format!("{} {} {}\n", 637_000.0 + x, 5_403_000.0 + y, 400.0 + z)
    };
    (0..8).map(corner).collect::<String>() + "637000.25 5403000 400\n"
}

fn with_corners(name: &str) -> Folder {
    let folder = Folder::new(name);
    fs::write(folder.path("corners.xyz"), corners()).unwrap();
    folder
}

/// What must not depend on the device.
fn answers(mut found: Value) -> Value {
    let fields = found.as_object_mut().unwrap();
    for of_the_run in ["milliseconds", "build_stages", "device", "memory_bytes", "notes"] {
        assert!(fields.remove(of_the_run).is_some(), "{of_the_run}");
    }
    found
}

#[test]
fn octree_counts_nodes_and_leaves_by_level() {
    let folder = with_corners("octree-json");
    let found = folder.json("octree corners.xyz --leaf 1 --device cpu --json");
    // 0.25 of 8 is one cell of 32 at level 5: the two close points part there.
    let expected = json!({
        "points": 9, "source": "points", "curve": "morton", "leaf_capacity": 1, "max_depth": 21,
        "domain_min": [637_000.0, 5_403_000.0, 400.0], "domain_edge": 8.0,
        "depth": 5, "nodes": 14, "leaves": 9,
        "nodes_by_level": [1, 8, 1, 1, 1, 2], "leaves_by_level": [0, 7, 0, 0, 0, 2],
        "leaf_points_mean": 1.0, "leaf_points_max": 1, "located": [], "partition": null, "structure": "linear-octree",
    });
    assert!(found["device"].as_str().unwrap().starts_with("cpu (") && found["memory_bytes"].as_u64().unwrap() > 0);
    for stage in ["read", "open", "upload", "build", "read_back", "partition", "write", "picture"] {
        assert!(found["milliseconds"][stage].is_number(), "{stage}: {found}");
    }
    assert_eq!(answers(found), expected);
    let shallow = folder.json("octree corners.xyz --leaf 1 --max-depth 1 --device cpu --json");
    assert_eq!((&shallow["nodes_by_level"], &shallow["leaf_points_max"]), (&json!([1, 8]), &json!(2)));
    let told = folder.ok("octree corners.xyz --leaf 1 --device cpu --parts 2 --radius 1");
    for words in ["14 nodes, 9 leaves, depth 5", "level  nodes  leaves", "part  points", "hilbert", "within 1 of"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    assert!(folder.ok("octree corners.xyz --device cpu --quiet").is_empty());
}

#[test]
fn octree_locates_places_in_map_coordinates() {
    let folder = with_corners("octree-locate");
    let places = "--locate 637008,5403008,408 --locate 637000.25,5403000,400 --locate 637003,5403000,400 \
                  --locate -5,5403000,400";
    for curve in ["morton", "hilbert"] {
        let found =
            folder.json(&format!("octree corners.xyz --leaf 1 --device cpu --json --parts 4 --curve {curve} {places}"));
        let [far, close, between, outside] = &found["located"].as_array().unwrap()[..] else { panic!("{found}") };
        let node = |found: &Value, field: &str| found["node"][field].clone();
        assert_eq!((node(far, "level"), node(far, "cell")), (json!(1), json!([1, 1, 1])), "{far}");
        assert_eq!((node(far, "points"), node(far, "is_leaf")), (json!(1), json!(true)), "{far}");
        assert_eq!((node(close, "level"), node(close, "cell")), (json!(5), json!([1, 0, 0])), "{close}");
        // Nothing is at 3: the smallest node around it is the octant of edge 4 with both close points.
        assert_eq!((node(between, "level"), node(between, "points")), (json!(1), json!(2)), "{between}");
        assert_eq!(node(between, "is_leaf"), false, "{between}");
        // Outside there is no node, but still an owner: that of the nearest border cell.
        assert_eq!((&outside["node"], &outside["place"]), (&Value::Null, &json!([-5.0, 5_403_000.0, 400.0])));
        assert!(outside["part"].as_u64().unwrap() < 4 && far["part"].as_u64().unwrap() < 4);
    }
    let far = &folder.json(&format!("octree corners.xyz --leaf 1 --device cpu --json {places}"))["located"][0];
    // Morton: the last child of the root, key 7; no parts were asked for.
    assert_eq!(
        (&far["node"]["octant"], &far["node"]["key"], &far["part"]),
        (&json!("0xf"), &json!("0x7"), &Value::Null)
    );
}

#[test]
fn parts_tell_their_work_surface_and_exchange_on_both_curves() {
    let folder = with_corners("octree-parts");
    let found =
        folder.json("octree corners.xyz --leaf 1 --device cpu --json --parts 3 --radius 8 --bytes-per-point 12");
    let partition = &found["partition"];
    assert_eq!((&partition["parts"], &partition["radius"]), (&json!(3), &json!(8.0)));
    let parts = partition["by_part"].as_array().unwrap();
    assert_eq!((parts.len(), &partition["imbalance"]), (3, &json!(1.0)));
    // Along Morton's curve 0, its neighbour and 1, then 2 3 4, then 5 6 7. Edges of the cube are as long as the radius:
    // 0 and its neighbour go to the second part, 1 to both others, and so on. The two small leaves touch only each other.
    for (i, (sent, surface)) in [(4, 1), (6, 3), (4, 3)].into_iter().enumerate() {
        let part = &parts[i];
        assert_eq!((&part["part"], &part["points"], &part["leaves"]), (&json!(i), &json!(3), &json!(3)), "{part}");
        assert_eq!((&part["sent"], &part["received"]), (&json!(sent), &json!(sent)), "{part}");
        assert_eq!((&part["bytes"], &part["surface"]), (&json!(12 * sent), &json!(surface)), "{part}");
    }
    let sum = |field: &str| parts.iter().map(|part| part[field].as_u64().unwrap()).sum::<u64>();
    let totals = &partition["totals"];
    for field in ["points", "leaves", "surface", "sent", "received", "bytes"] {
        assert_eq!(totals["morton"][field], json!(sum(field)), "{field}");
    }
    assert_eq!(sum("sent"), sum("received"));
    assert!(totals["hilbert"]["surface"].is_number() && totals["hilbert"]["imbalance"].is_number());
    // The other curve gives the same two sums.
    let hilbert = folder.json(
        "octree corners.xyz --leaf 1 --device cpu --json --parts 3 --radius 8 --bytes-per-point 12 --curve hilbert",
    );
    assert_eq!(&hilbert["partition"]["totals"], totals);
    let without = folder.json("octree corners.xyz --leaf 1 --device cpu --json --parts 3");
    assert_eq!(
        (&without["partition"]["radius"], &without["partition"]["by_part"][0]["sent"]),
        (&Value::Null, &Value::Null)
    );
    let percent = folder.json("octree corners.xyz --leaf 1 --device cpu --json --parts 3 --radius 50%");
    assert!((percent["partition"]["radius"].as_f64().unwrap() - 48f64.sqrt()).abs() < 1e-5, "{percent}");
}

#[test]
fn octrees_of_cpu_and_gpu_answer_alike() {
    let Some(device) = gpu_or_skip("octrees_of_cpu_and_gpu_answer_alike") else { return };
    let folder = Folder::new("octree-devices");
    folder.ok("generate clustered -n 20000 -o clusters.ply -q");
    folder.ok("generate terrain -n 30000 -o ground.pcd -q");
    for file in ["clusters.ply", "ground.pcd"] {
        for curve in ["morton", "hilbert"] {
            let run = |device: &str, name: &str| {
                let mut command = folder.command(&format!(
                    "octree {file} --leaf 16 --curve {curve} --parts 7 --radius 0.5% --locate 0.5,0.5,0.5 --json \
                     --output {name}.npz --picture {name}.png --picture-size 320x240 --force"
                ));
                let output = command.args(["--device", device]).output().unwrap();
                assert!(output.status.success(), "{file}, {curve}, {device}: {output:?}");
                serde_json::from_slice::<Value>(&output.stdout).unwrap()
            };
            let (on_cpu, on_gpu) = (run("cpu", "cpu"), run(&device, "gpu"));
            assert_ne!(on_cpu["device"], on_gpu["device"]);
            assert_eq!(answers(on_cpu), answers(on_gpu), "{file}, {curve}");
            for kind in ["npz", "png"] {
                let [a, b] = ["cpu", "gpu"].map(|name| fs::read(folder.path(&format!("{name}.{kind}"))).unwrap());
                assert!(a == b, "{file}, {curve}: files .{kind} differ");
            }
        }
    }
}

/// An array of the archive by name, as numbers.
fn numbers(arrays: &[(String, String, Vec<u8>)], name: &str, kind: &str) -> Vec<u64> {
    let (_, found, bytes) = arrays.iter().find(|a| a.0 == format!("{name}.npy")).unwrap_or_else(|| panic!("{name}"));
    assert_eq!(found, kind, "{name}");
    let number = |b: &[u8]| b.iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte));
    bytes.chunks_exact(kind[2..].parse().unwrap()).map(number).collect()
}

#[test]
fn octree_writes_arrays_that_fit_together() {
    let folder = Folder::new("octree-npz");
    folder.ok("generate shell -n 3000 -o shell.ply -q");
    let found = folder.json("octree shell.ply --leaf 8 --device cpu --parts 5 -o tree.npz --json");
    let arrays = npz_arrays(&fs::read(folder.path("tree.npz")).unwrap());
    let words = |name: &str| numbers(&arrays, name, "<u4");
    let (octants, levels) = (numbers(&arrays, "octants", "<u8"), numbers(&arrays, "levels", "|u1"));
    let (first, end) = (words("first_points"), words("end_points"));
    let (parents, children) = (words("parents"), words("first_children"));
    let masks = numbers(&arrays, "child_masks", "|u1");
    let n = found["nodes"].as_u64().unwrap() as usize;
    assert_eq!((octants.len(), octants[0], levels[0], parents[0]), (n, 1, 0, u64::from(u32::MAX)));
    for i in 0..n {
        // A 1 bit and three bits a level.
        assert_eq!(u64::from(octants[i].ilog2()), 3 * levels[i], "node {i}");
        if i > 0 {
            let parent = parents[i] as usize;
            assert_eq!(octants[parent], octants[i] >> 3, "node {i}");
            assert!(masks[parent] >> (octants[i] & 7) & 1 == 1, "node {i}");
            assert!(first[parent] <= first[i] && end[i] <= end[parent], "node {i}");
            let own = children[parent]..children[parent] + u64::from(masks[parent].count_ones());
            assert!(own.contains(&(i as u64)), "node {i}");
        }
        let is_leaf = children[i] == u64::from(u32::MAX);
        assert_eq!((masks[i] == 0, end[i] - first[i] <= 8), (is_leaf, is_leaf), "node {i}");
    }
    for (name, len) in [("pre_order", n), ("post_order", n), ("order", 3000)] {
        let mut sorted = words(name);
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..len as u64), "{name} is a permutation");
    }
    let parts = words("part_of_point");
    for part in found["partition"]["by_part"].as_array().unwrap() {
        let n_points = parts.iter().filter(|&&p| json!(p) == part["part"]).count();
        assert_eq!(json!(n_points), part["points"]);
    }
    // Parts are contiguous along the order.
    assert!(words("order").iter().map(|&i| parts[i as usize]).is_sorted());
    folder.ok("octree shell.ply --device cpu -o plain.npz -q");
    let plain = npz_arrays(&fs::read(folder.path("plain.npz")).unwrap());
    assert!(plain.iter().all(|(name, ..)| name != "part_of_point.npy") && plain.len() == 10);
}

#[test]
fn meshes_enter_by_the_centroids_of_their_triangles() {
    let folder = Folder::new("octree-mesh");
    folder.ok("generate icosphere -n 1280 -o ball.obj -q");
    let centroids = folder.json("octree ball.obj --device cpu --json");
    assert_eq!((&centroids["points"], &centroids["source"]), (&json!(1280), &json!("triangle centroids")));
    let vertices = folder.json("octree ball.obj --vertices --device cpu --json");
    assert_eq!((&vertices["points"], &vertices["source"]), (&json!(642), &json!("points")));
    assert!(folder.ok("octree ball.obj --device cpu").contains("1,280, the centroids of triangles"));
}

#[test]
fn octree_drops_invalid_points_and_takes_none() {
    let folder = Folder::new("octree-invalid");
    fs::write(folder.path("bad.xyz"), "0 0 0\nnan 0 0\n1 0 0\n").unwrap();
    folder.fails("octree bad.xyz", 65, "first at index 1");
    let found = folder.json("octree bad.xyz --drop-invalid --device cpu --json");
    assert_eq!(found["points"], 2);
    assert!(found["notes"][0].as_str().unwrap().contains("1 points"), "{found}");
    folder.ok("generate uniform -n 0 -o none.ply -q");
    let none = folder
        .json("octree none.ply --device cpu --json --parts 3 --radius 1 --locate 0,0,0 -o none.npz --picture none.png");
    assert_eq!((&none["nodes"], &none["depth"], &none["nodes_by_level"]), (&json!(0), &json!(0), &json!([])));
    assert_eq!(
        (&none["located"][0]["node"], &none["partition"]["totals"]["morton"]["sent"]),
        (&Value::Null, &json!(0))
    );
    folder.ok("octree none.ply --device cpu --picture slice.png -q");
    // More parts than points, and all points equal.
    fs::write(folder.path("equal.xyz"), "1 2 3\n".repeat(40)).unwrap();
    let equal = folder.json("octree equal.xyz --device cpu --json --parts 30 --radius 0 --picture equal.png");
    let parts = equal["partition"]["by_part"].as_array().unwrap();
    assert_eq!(parts.iter().filter(|part| part["points"] == 40).count(), 1, "{equal}");
    assert_eq!((&equal["depth"], &equal["partition"]["totals"]["morton"]["surface"]), (&json!(21), &json!(0)));
}

#[test]
fn pictures_show_parts_or_the_cells_of_a_slice() {
    let folder = Folder::new("octree-picture");
    folder.ok("generate uniform -n 4000 -o cube.ply -q");
    folder.ok("octree cube.ply --device cpu --parts 3 --picture parts.png --picture-size 480x300 -q");
    folder.ok("octree cube.ply --device cpu --picture slice.png --picture-size 480x300 -q");
    for name in ["parts.png", "slice.png"] {
        assert_eq!(png_size(&folder.path(name)), (480, 300), "{name}");
    }
    // Blue, orange and green points, each where they are lit.
    let pixels = png_pixels(&folder.path("parts.png"));
    let count = |keep: &dyn Fn(&[u8; 3]) -> bool| pixels.iter().filter(|p| keep(p)).count();
    assert!(count(&|p| p[2] > 100 && p[2] > 2 * p[0]) > 1000, "blue");
    assert!(count(&|p| p[0] > 100 && p[0] > 2 * p[2]) > 1000, "orange");
    assert!(count(&|p| p[1] > 80 && u32::from(p[1]) * 2 > 3 * u32::from(p[0].max(p[2]))) > 1000, "green");
    // A slice of a cube is a square of some 194 pixels, cells in colours of the scale.
    let pixels = png_pixels(&folder.path("slice.png"));
    let colored = pixels.iter().filter(|p| p.iter().max().unwrap() - p.iter().min().unwrap() > 30).count();
    assert!((20_000..60_000).contains(&colored), "{colored} pixels");
}
