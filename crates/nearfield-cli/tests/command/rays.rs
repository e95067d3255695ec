//! `nearfield heatmap` and `raycast`: their numbers, their files and their pictures, on the CPU and on the GPU.

use std::fs;

use serde_json::{Value, json};

use crate::neighbors::{npz_arrays, png_pixels};
use crate::{Folder, gpu_or_skip, png_size};

/// Two squares of edge 2 across the z axis, at z = 0 and at z = 1, as quads: four triangles, or two of three corners.
pub(crate) const PLATES: &str =
    "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\nf 1 2 3 4\nf 5 6 7 8\n";

pub(crate) fn with_plates(name: &str) -> Folder {
    let folder = Folder::new(name);
    fs::write(folder.path("plates.obj"), PLATES).unwrap();
    folder
}

#[test]
fn brute_force_tests_every_triangle_for_each_pixel_and_the_box_only_where_it_is_hit() {
    let folder = with_plates("heatmap-brute");
    let shoot = "heatmap plates.obj --size 200x200 --device cpu --json --force -o map.png";
    let found = folder.json(&format!("{shoot} --structure brute-force"));
    let tests = &found["metrics"]["triangle_tests"];
    let all = json!({ "pixels": 40_000, "min": 4, "mean": 4.0, "median": 4, "p99": 4, "max": 4 });
    assert_eq!((&tests["all"], &tests["touched"]), (&all, &all));
    assert_eq!(
        (&found["triangles"], &found["rays"], &found["metric"]),
        (&json!(4), &json!(40_000), &json!("triangle_tests"))
    );
    let hits = found["hits"].as_u64().unwrap();
    // The view is filled by the plates: they take a good part of it, but not the corners.
    assert!((10_000..38_000).contains(&hits), "{hits}");

    let three = folder.json(&format!("{shoot} --structure brute-force --corners three"));
    assert_eq!((&three["triangles"], &three["metrics"]["triangle_tests"]["all"]["min"]), (&json!(2), &json!(2)));
    assert!(three["hits"].as_u64().unwrap() < hits);

    let boxed = folder.json(&format!("{shoot} --structure bounding-box"));
    let tests = &boxed["metrics"]["triangle_tests"];
    assert_eq!(
        (&tests["all"]["min"], &tests["touched"]["min"], &tests["touched"]["max"]),
        (&json!(0), &json!(4), &json!(4))
    );
    let touched = tests["touched"]["pixels"].as_u64().unwrap();
    assert!(hits <= touched && touched < 40_000 && boxed["hits"] == found["hits"], "{boxed}");
}

#[test]
fn structures_agree_on_what_is_hit_and_trees_test_less() {
    let folder = Folder::new("heatmap-trees");
    folder.ok("generate icosphere -n 5120 -o ball.ply -q");
    let shoot = |more: &str| {
        let map =
            format!("heatmap ball.ply --size 200x210 --device cpu --csv map.csv --json --force -o map.png {more}");
        let found = folder.json(&map);
        let text = fs::read_to_string(folder.path("map.csv")).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("x,y,triangle,t,triangle_tests,node_visits,leaf_visits,rope_steps"));
        let rows: Vec<Vec<String>> = lines.map(|line| line.split(',').map(str::to_owned).collect()).collect();
        assert_eq!(rows.len(), 200 * 210);
        (found, rows)
    };
    let (brute, reference) = shoot("--structure brute-force");
    for (more, structure) in [
        ("--leaf 20", "kd-tree"),
        ("--leaf 20 --walk stack", "kd-tree"),
        ("--build binned-sah", "kd-tree"),
        ("--build exact-sah --leaf 4", "kd-tree"),
        ("--structure triangle-bvh", "triangle-bvh"),
    ] {
        let (found, rows) = shoot(more);
        assert_eq!((&found["hits"], &found["structure"]["name"]), (&brute["hits"], &json!(structure)), "{more}");
        assert!(
            rows.iter().zip(&reference).all(|(row, expected)| row[..4] == expected[..4]),
            "{more}: another triangle"
        );
        // The numbers that are printed are those of the table.
        for (metric, column) in [("triangle_tests", 4), ("node_visits", 5), ("leaf_visits", 6), ("rope_steps", 7)] {
            let mut counts: Vec<u64> = rows.iter().map(|row| row[column].parse().unwrap()).collect();
            counts.sort_unstable();
            let all = &found["metrics"][metric]["all"];
            let n = counts.len();
            let expected = [counts[0], counts[n.div_ceil(2) - 1], counts[(n * 99).div_ceil(100) - 1], counts[n - 1]];
            for (name, expected) in ["min", "median", "p99", "max"].into_iter().zip(expected) {
                assert_eq!(all[name], expected, "{more}: {metric} {name}");
            }
            let mean = counts.iter().sum::<u64>() as f64 / n as f64;
            assert!((all["mean"].as_f64().unwrap() - mean).abs() < 1e-9, "{more}: {metric}");
        }
        let most = found["metrics"]["triangle_tests"]["all"]["max"].as_u64().unwrap();
        assert!((1..1000).contains(&most), "{more}: {most} of 5120 triangles");
        let ropes = found["metrics"]["rope_steps"]["all"]["max"].as_u64().unwrap();
        assert_eq!(ropes > 0, structure == "kd-tree" && !more.contains("stack"), "{more}");
    }
}

#[test]
fn heat_maps_have_a_pixel_a_ray_in_the_colors_of_their_scale() {
    let folder = with_plates("heatmap-picture");
    let told = folder.ok("heatmap plates.obj --size 300x240 --structure bounding-box --device cpu -o accel.png");
    for words in
        ["72,000 (300 x 240)", "triangle tests", "touched", "Mrays/s", "brute force within the bounding box", "p99"]
    {
        assert!(told.contains(words), "{words}: {told}");
    }
    // Title above and legend beside the rays.
    assert_eq!(png_size(&folder.path("accel.png")), (490, 346));
    let pixels = png_pixels(&folder.path("accel.png"));
    let raster = |pixels: &[[u8; 3]]| -> Vec<[u8; 3]> {
        (0..300 * 240).map(|i| pixels[(76 + i / 300) * 490 + 30 + i % 300]).collect()
    };
    let seen = raster(&pixels);
    let count = |color: [u8; 3]| seen.iter().filter(|&&pixel| pixel == color).count();
    let (green, red) = (count([0, 255, 0]), count([255, 0, 0]));
    assert!(green + red == 300 * 240 && green > 1000 && red > 10_000, "{green} green, {red} red");
    folder.ok(
        "heatmap plates.obj --size 300x240 --structure bounding-box --device cpu --colors perceptual -o violet.png -q",
    );
    let seen = raster(&png_pixels(&folder.path("violet.png")));
    let yellow = seen.iter().filter(|p| p[0] > 220 && p[1] > 200 && p[2] < 80).count();
    assert_eq!(yellow, red);
}

#[test]
fn heat_maps_of_a_device_have_the_hits_of_the_cpu() {
    let Some(device) = gpu_or_skip("heat_maps_of_a_device_have_the_hits_of_the_cpu") else { return };
    let folder = Folder::new("heatmap-gpu");
    folder.ok("generate icosphere -n 320 -o ball.ply -q");
    for more in ["--structure brute-force", "--leaf 20", "--structure triangle-bvh"] {
        let shoot = |device: &str| {
            folder.json(&format!("heatmap ball.ply --size 200x200 {more} --device {device} --json --force -o map.png"))
        };
        let (cpu, gpu) = (shoot("cpu"), shoot(&device));
        let hits = |found: &Value| found["hits"].as_i64().unwrap();
        // Rays within rounding of the outline may fall to either side.
        assert!((hits(&cpu) - hits(&gpu)).abs() <= 8, "{more}: {} and {}", hits(&cpu), hits(&gpu));
        if !more.contains("bvh") {
            let mean = |found: &Value| found["metrics"]["triangle_tests"]["all"]["mean"].as_f64().unwrap();
            assert!((mean(&cpu) - mean(&gpu)).abs() < 0.01 * mean(&cpu), "{more}: {} and {}", mean(&cpu), mean(&gpu));
        }
        assert!(!gpu["device"].as_str().unwrap().starts_with("cpu ("), "{gpu}");
    }
}

/// Straight down through both plates, from between them, past them, one that is no ray, and one that ends too soon.
const RAYS: &str = "0.5 0.25 5 0 0 -1 0 inf\n0.5 0.25 0.5 0 0 -2 0 inf\n9 0 5 0 0 -1 0 inf\n0 0 5 0 0 0 0 inf\n0.5 0.25 5 0 0 -1 0 3.5\n";

/// An array of the archive, its type and its bytes as numbers.
fn array(arrays: &[(String, String, Vec<u8>)], name: &str) -> (String, Vec<f64>) {
    let (_, kind, bytes) = arrays.iter().find(|a| a.0 == format!("{name}.npy")).unwrap_or_else(|| panic!("no {name}"));
    let number = |b: &[u8]| match kind.as_str() {
        "<f4" => f64::from(f32::from_le_bytes(b.try_into().unwrap())),
        "<f8" => f64::from_le_bytes(b.try_into().unwrap()),
        _ => b.iter().rev().fold(0u64, |n, &byte| n << 8 | u64::from(byte)) as f64,
    };
    (kind.clone(), bytes.chunks_exact(kind[2..].parse().unwrap()).map(number).collect())
}

#[test]
fn rays_of_a_file_find_their_triangles() {
    let folder = with_plates("raycast");
    fs::write(folder.path("rays.txt"), RAYS).unwrap();
    let mut devices = vec!["cpu".to_owned()];
    devices.extend(gpu_or_skip("rays_of_a_file_find_their_triangles"));
    for device in devices {
        for structure in ["brute-force", "bounding-box", "kd-tree", "triangle-bvh"] {
            let cast =
                format!("raycast plates.obj --rays rays.txt --structure {structure} --device {device} --json --force");
            let found = folder.json(&format!("{cast} -o hits.npz"));
            let fields = ["rays", "rays_that_hit", "invalid", "query"].map(|name| found[name].clone());
            assert_eq!(fields, [json!(5), json!(2), json!(1), json!("closest")], "{found}");
            assert!(found["notes"].to_string().contains("ray 3, has no direction"), "{found}");
            let arrays = npz_arrays(&fs::read(folder.path("hits.npz")).unwrap());
            let get = |name: &str| array(&arrays, name).1;
            // (0.5, 0.25) lies in the first triangle of its square, x > y.
            let (miss, invalid) = (4_294_967_295.0, 4_294_967_294.0);
            assert_eq!(array(&arrays, "triangle"), ("<u4".to_owned(), vec![2.0, 0.0, miss, invalid, miss]));
            assert_eq!(get("t"), [4.0, 0.25, f64::INFINITY, f64::INFINITY, f64::INFINITY]);
            assert_eq!(get("position")[..6], [0.5, 0.25, 1.0, 0.5, 0.25, 0.0]);
            assert_eq!(get("normal")[..6], [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
            assert_eq!(get("barycentrics")[..3], [0.25, 0.125, 0.625]);
            assert!(get("position")[6..].iter().all(|v| v.is_nan()));
            assert_eq!(array(&arrays, "invalid"), ("<u8".to_owned(), vec![3.0]));

            folder.json(&format!("{cast} --query any -o any.npz"));
            let arrays = npz_arrays(&fs::read(folder.path("any.npz")).unwrap());
            assert_eq!(array(&arrays, "hit"), ("|u1".to_owned(), vec![1.0, 1.0, 0.0, 2.0, 0.0]));
            folder.json(&format!("{cast} --query count -o count.npz"));
            let arrays = npz_arrays(&fs::read(folder.path("count.npz")).unwrap());
            assert_eq!(array(&arrays, "count"), ("<u4".to_owned(), vec![2.0, 1.0, 0.0, 0.0, 0.0]));
            let found = folder.json(&format!("{cast} --query all -o all.npz"));
            assert_eq!((&found["hits"], &found["rays_that_hit"]), (&json!(3), &json!(2)));
            let arrays = npz_arrays(&fs::read(folder.path("all.npz")).unwrap());
            assert_eq!(array(&arrays, "offsets").1, [0.0, 2.0, 3.0, 3.0, 3.0, 3.0]);
            assert_eq!(array(&arrays, "triangle").1, [2.0, 0.0, 0.0]);
            assert_eq!(array(&arrays, "t").1, [4.0, 5.0, 0.25]);
        }
    }
    let told = folder.ok("raycast plates.obj --rays rays.txt --device cpu --query all -o told.npz");
    for words in ["5, 2 that hit, 3 hits in all, 1 invalid", "plates.obj, 4 triangles", "1 of 5 rays cannot be cast"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    let piped = folder.pipe("raycast plates.obj --rays - --device cpu --json -o piped.npz", RAYS.as_bytes());
    assert!(piped.status.success(), "{piped:?}");
    assert_eq!(fs::read(folder.path("piped.npz")).unwrap(), fs::read(folder.path("hits.npz")).unwrap());
}

#[test]
fn auto_takes_what_the_rays_are_worth_and_says_why() {
    let folder = with_plates("raycast-auto");
    fs::write(folder.path("rays.txt"), RAYS).unwrap();
    folder.ok("generate icosphere -n 20480 -o ball.ply -q");
    let auto = "raycast plates.obj --rays rays.txt --device cpu --structure auto";
    let few = folder.json(&format!("{auto} --json -o few.npz"))["structure"].clone();
    let reason = few["reason"].as_str().unwrap();
    assert!(few["name"] == "brute-force" && reason.contains("5 rays into 4 triangles"), "{few}");
    let told = folder.ok(&format!("{auto} --force -o few.npz"));
    assert!(told.contains("auto chose brute-force: 5 rays into 4 triangles"), "{told}");
    let map = "heatmap ball.ply --size 200x200 --device cpu --force --json -o map.png";
    let many = folder.json(&format!("{map} --structure auto"))["structure"].clone();
    assert!(many["name"] == "triangle-bvh" && many["reason"].as_str().unwrap().contains("40000 rays"), "{many}");
    let ropes = folder.json(&format!("{map} --structure auto --metric rope-steps"))["structure"].clone();
    assert_eq!(
        (&ropes["name"], &ropes["reason"]),
        (&json!("kd-tree"), &json!("auto chose kd-tree: only the kd-tree has ropes"))
    );
    let named = folder.json(&format!("{map} --structure kd-tree"))["structure"].clone();
    assert!(named["reason"].is_null(), "{named}");
}

#[test]
fn rays_into_map_coordinates_keep_their_millimetres() {
    let folder = Folder::new("raycast-map");
    fs::write(folder.path("far.obj"), "v 637000 5403000 0\nv 637001 5403000 0\nv 637000 5403001 0\nf 1 2 3\n").unwrap();
    fs::write(folder.path("rays.csv"), "x,y,z,dx,dy,dz\n637000.125,5403000.25,5,0,0,-1\n").unwrap();
    folder.ok("raycast far.obj --rays rays.csv --device cpu -o hits.npz -q");
    let arrays = npz_arrays(&fs::read(folder.path("hits.npz")).unwrap());
    assert_eq!(array(&arrays, "position"), ("<f8".to_owned(), vec![637_000.125, 5_403_000.25, 0.0]));
    assert_eq!(array(&arrays, "triangle").1, [0.0]);
}

#[test]
fn no_rays_give_empty_arrays_and_bad_ones_say_where() {
    let folder = with_plates("raycast-bad");
    fs::write(folder.path("none.txt"), "# none\n").unwrap();
    let found = folder.json("raycast plates.obj --rays none.txt --query all --device cpu --json -o none.npz");
    assert_eq!((&found["rays"], &found["hits"]), (&json!(0), &json!(0)));
    for (name, content, told) in [
        ("five.txt", &b"1 2 3 4 5\n"[..], "five.txt:1"),
        ("word.txt", b"0 0 0 0 0 1\n0 0 0 down 0 1\n", "word.txt:2"),
        ("cut.npy", b"\x93NUMPY\x01\x00", "cut.npy"),
        ("noise.npz", b"PK\x03\x04noise", "noise.npz"),
    ] {
        fs::write(folder.path(name), content).unwrap();
        folder.fails(&format!("raycast plates.obj --rays {name} --device cpu -o out.npz"), 65, told);
    }
    fs::write(folder.path("points.xyz"), "0 0 0\n1 1 1\n").unwrap();
    fs::write(folder.path("nan.obj"), "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n").unwrap();
    fs::write(folder.path("points.obj"), "v 0 0 0\nv 1 0 0\n").unwrap();
    for verb in ["raycast FILE --rays none.txt -o out.npz", "heatmap FILE -o out.png"] {
        folder.fails(
            &format!("{} --device cpu", verb.replace("FILE", "points.obj")),
            65,
            "2 vertices and no triangles",
        );
        folder.fails(&format!("{} --device cpu", verb.replace("FILE", "nan.obj")), 65, "nan.obj");
        folder.fails(&format!("{} --device cpu", verb.replace("FILE", "nowhere.obj")), 66, "nowhere.obj");
        folder.fails(&format!("{} --device gpu:99", verb.replace("FILE", "plates.obj")), 69, "gpu:99");
    }
    assert!(!folder.path("out.npz").exists() && !folder.path("out.png").exists());
}
