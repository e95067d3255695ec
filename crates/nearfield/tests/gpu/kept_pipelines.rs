//! Pipelines that are kept in a file: written as a whole, used again, and no harm where the file is damaged, foreign or cannot be had.

use std::fs;
use std::path::{Path, PathBuf};

use libtest_mimic::Trial;
use nearfield::gpu::{Access, Gpu, Kernel, wgpu};
use nearfield::{FixedRadius, GpuBruteForce, NeighborSearch};

use crate::support::gpu_trial;
use crate::{RADIUS, adapter_of, lattice_points, rows_by_loop, wrong_row};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("pipelines_are_kept_in_a_file", pipelines_are_kept_in_a_file),
        gpu_trial("damaged_files_of_pipelines_do_no_harm", damaged_files_do_no_harm),
        gpu_trial("pipelines_are_compiled_where_no_file_can_be", pipelines_are_compiled_where_no_file_can_be),
        gpu_trial("contexts_write_their_pipelines_at_the_same_time", contexts_write_at_the_same_time),
    ]
}

/// A folder for one test, not made yet.
fn folder(test: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("nearfield-{test}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

/// Opens a context with this folder, asks it something and drops it.
fn use_once(gpu: &Gpu, folder: Option<&Path>) {
    let own = Gpu::open_adapter_with_cache(&adapter_of(gpu), folder).unwrap();
    let points = lattice_points(200);
    let list = GpuBruteForce::build(&own, &points).unwrap().list(&FixedRadius::new(RADIUS)).unwrap();
    assert_eq!(wrong_row(&list, &rows_by_loop(&points, &points, RADIUS)), None);
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries.map(|entry| entry.unwrap().path()).collect()
}

/// Whether the driver keeps pipelines at all.
fn keeps(gpu: &Gpu) -> bool {
    let own = Gpu::open_adapter_with_cache(&adapter_of(gpu), Some(&folder("feature"))).unwrap();
    own.device().features().contains(wgpu::Features::PIPELINE_CACHE)
}

fn pipelines_are_kept_in_a_file(gpu: &Gpu) {
    let folder = folder("kept");
    let kept = usize::from(keeps(gpu));
    use_once(gpu, Some(&folder));
    let written = files(&folder);
    assert_eq!(written.len(), kept, "{written:?}");
    let before: Vec<_> = written.iter().map(|file| fs::read(file).unwrap()).collect();
    assert!(before.iter().all(|bytes| bytes.starts_with(b"nearfield pipelines")));
    // A context that compiles nothing writes nothing.
    let modified = |file: &PathBuf| fs::metadata(file).unwrap().modified().unwrap();
    let times: Vec<_> = written.iter().map(modified).collect();
    drop(Gpu::open_adapter_with_cache(&adapter_of(gpu), Some(&folder)).unwrap());
    assert_eq!(written.iter().map(modified).collect::<Vec<_>>(), times);
    use_once(gpu, Some(&folder));
    assert_eq!(files(&folder), written, "no file is left over");
    fs::remove_dir_all(&folder).unwrap_or(());
}

fn damaged_files_do_no_harm(gpu: &Gpu) {
    let folder = folder("damaged");
    use_once(gpu, Some(&folder));
    let written = files(&folder);
    let [file] = &written[..] else {
        assert!(!keeps(gpu));
        return;
    };
    let whole = fs::read(file).unwrap();
    let mut flipped = whole.clone();
    *flipped.last_mut().unwrap() ^= 1;
    let foreign = [&whole[..whole.len() / 2], &[0x5a; 4000]].concat();
    for (case, bytes) in
        [("empty", &[][..]), ("cut", &whole[..whole.len() - 1]), ("flipped", &flipped[..]), ("foreign", &foreign[..])]
    {
        fs::write(file, bytes).unwrap();
        use_once(gpu, Some(&folder));
        let repaired = fs::read(file).unwrap();
        assert!(
            repaired != bytes && repaired.starts_with(b"nearfield pipelines"),
            "{case}: a whole file takes its place"
        );
    }
    fs::remove_dir_all(&folder).unwrap();
}

fn pipelines_are_compiled_where_no_file_can_be(gpu: &Gpu) {
    use_once(gpu, None);
    // A file where the folder should be, and a folder where the file should be.
    let taken = folder("taken");
    fs::write(&taken, "a file").unwrap();
    use_once(gpu, Some(&taken));
    assert_eq!(fs::read(&taken).unwrap(), b"a file");
    fs::remove_file(&taken).unwrap();
    use_once(gpu, Some(&taken));
    for file in files(&taken) {
        fs::remove_file(&file).unwrap();
        fs::create_dir_all(file.join("inside")).unwrap();
    }
    use_once(gpu, Some(&taken));
    let _ = fs::remove_dir_all(&taken);
    // A pipeline that is refused is told of as ever.
    let own = Gpu::open_adapter_with_cache(&adapter_of(gpu), Some(&taken)).unwrap();
    let refused = own.pipeline(&Kernel::new("package::query::small_list", "not_there", &[Access::Uniform], 64));
    assert!(refused.is_err());
    drop(own);
    let _ = fs::remove_dir_all(&taken);
}

fn contexts_write_at_the_same_time(gpu: &Gpu) {
    let folder = folder("together");
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| use_once(gpu, Some(&folder)));
        }
    });
    let written = files(&folder);
    assert_eq!(written.len(), usize::from(keeps(gpu)), "{written:?}");
    use_once(gpu, Some(&folder));
    let _ = fs::remove_dir_all(&folder);
}
