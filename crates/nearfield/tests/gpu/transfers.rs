//! Data to the device and back: every length around the chunks, memory that is short, order, threads at the same time, and values that come with the
//! work.

use libtest_mimic::Trial;
use nearfield::Error;
use nearfield::gpu::{Buffer, Gpu};

use crate::memory::refuse_each;
use crate::support::{Random, gpu_trial};
use crate::{SEED, own_context};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("bytes_of_any_number_come_back", bytes_of_any_number_come_back),
        gpu_trial("parts_of_large_buffers_are_written_and_read", parts_of_large_buffers_are_written_and_read),
        gpu_trial("elements_made_one_by_one_are_those_of_a_slice", elements_made_one_by_one_are_those_of_a_slice),
        gpu_trial("large_writes_keep_their_place_among_submissions", large_writes_keep_their_place),
        gpu_trial("large_transfers_take_the_memory_there_is", large_transfers_take_the_memory_there_is),
        gpu_trial("threads_transfer_at_the_same_time", threads_transfer_at_the_same_time),
        gpu_trial("values_come_with_the_work", values_come_with_the_work),
        gpu_trial("recorded_work_runs_again_with_new_values", recorded_work_runs_again_with_new_values),
    ]
}

fn words(n: usize) -> Vec<u32> {
    let mut random = Random(SEED);
    (0..n).map(|_| random.word()).collect()
}

/// Words of 256 KiB, 1 MiB, 2 MiB and 8 MiB: where copies are shared, staged, cut and of the largest size.
const BOUNDARIES: [usize; 4] = [1 << 16, 1 << 18, 1 << 19, 1 << 21];

fn bytes_of_any_number_come_back(gpu: &Gpu) {
    let all = words((9 << 20) / 4 + 1000);
    let around = |n: usize| [n - 1, n, n + 1];
    for n in BOUNDARIES.into_iter().flat_map(around).chain([0, 1, 2, 1000, all.len()]) {
        let buffer = gpu.upload("words", &all[..n]).unwrap();
        assert!(gpu.read(&buffer).unwrap() == all[..n], "{n} words");
    }
    let bytes: &[u8] = bytemuck::cast_slice(&all);
    for n in [1, 3, 5, (1 << 20) + 3, (2 << 20) + 1, (5 << 20) - 1] {
        let buffer = gpu.upload("bytes", &bytes[..n]).unwrap();
        assert!(gpu.read(&buffer).unwrap() == bytes[..n], "{n} bytes");
        assert!(gpu.read_range(&buffer, n / 3..n).unwrap() == bytes[n / 3..n], "from byte {} of {n}", n / 3);
    }
}

fn parts_of_large_buffers_are_written_and_read(gpu: &Gpu) {
    let n = (24 << 20) / 4 + 77;
    let mut expected = words(n);
    let buffer = gpu.upload("words", &expected).unwrap();
    let other: Vec<u32> = expected.iter().map(|w| !w).collect();
    let mut into = vec![0; 3 << 20];
    for (start, len) in [(1, 5), (1001, (3 << 20) - 7), (n - (2 << 20), 2 << 20), (7, n - 9)] {
        gpu.write(&buffer, start, &other[start..start + len]).unwrap();
        expected[start..start + len].copy_from_slice(&other[start..start + len]);
        assert!(gpu.read(&buffer).unwrap() == expected, "after writing {len} from {start}");
        assert!(
            gpu.read_range(&buffer, start..start + len).unwrap() == other[start..start + len],
            "{len} from {start}"
        );
        let len = len.min(into.len());
        gpu.read_into(&buffer, start, &mut into[..len]).unwrap();
        assert!(into[..len] == other[start..start + len], "into memory: {len} from {start}");
    }
    let past_the_end = gpu.read_into(&buffer, n - 2, &mut into[..3]);
    assert!(matches!(past_the_end, Err(Error::LengthMismatch { what: "words", .. })), "{past_the_end:?}");
    assert!(matches!(gpu.read_into(&buffer, usize::MAX, &mut into[..3]), Err(Error::LengthMismatch { .. })));
    gpu.read_into(&buffer, n, &mut into[..0]).unwrap();
}

fn elements_made_one_by_one_are_those_of_a_slice(gpu: &Gpu) {
    for n in [0, 1, 255, 70_000, 700_001] {
        let made = gpu.upload_with("four words", n, |i| [i as u32, !(i as u32), 7, (i * i) as u32]).unwrap();
        let right = |(i, v): (usize, &[u32; 4])| *v == [i as u32, !(i as u32), 7, (i * i) as u32];
        let found = gpu.read(&made).unwrap();
        assert!(found.len() == n && found.iter().enumerate().all(right), "{n} of 16 bytes");
        // Sizes that no block of bytes is a multiple of, and parts of words.
        let made = gpu.upload_with("three words", n, |i| [i as u32, 1, 2]).unwrap();
        assert!(gpu.read(&made).unwrap().iter().enumerate().all(|(i, v)| *v == [i as u32, 1, 2]), "{n} of 12 bytes");
        let made = gpu.upload_with("bytes", n, |i| (i % 251) as u8).unwrap();
        assert!(gpu.read(&made).unwrap().iter().enumerate().all(|(i, v)| *v == (i % 251) as u8), "{n} bytes");
    }
}

fn large_writes_keep_their_place(gpu: &Gpu) {
    let n = 3 << 20;
    let (first, second) = (words(n), vec![5u32; n]);
    let (a, b): (Buffer<u32>, Buffer<u32>) = (gpu.upload("a", &first).unwrap(), gpu.buffer("b", n).unwrap());
    for _ in 0..3 {
        let mut commands = gpu.commands("copy");
        commands.copy(&a, &b);
        commands.submit().unwrap();
        gpu.write(&a, 0, &second).unwrap();
        assert!(gpu.read(&b).unwrap() == first, "what was submitted before saw the old words");
        assert!(gpu.read(&a).unwrap() == second);
        gpu.write(&a, 0, &first).unwrap();
    }
}

fn large_transfers_take_the_memory_there_is(gpu: &Gpu) {
    let own = own_context(gpu);
    let n = (20 << 20) / 4;
    let (first, second) = (words(n), vec![9u32; n]);
    let buffer = own.upload("words", &first).unwrap();
    let differs = |wrong: bool| wrong.then(|| "wrong words".to_owned());
    let used = own.memory_used();
    let staged = refuse_each(&own, "read", || own.read(&buffer), |found| differs(*found != first));
    assert!(staged >= 2, "{staged} pieces of staging memory");
    let write = || {
        own.write(&buffer, 0, &second)?;
        let found = own.read_range(&buffer, n - 10..n)?;
        own.write(&buffer, 0, &first)?;
        Ok(found)
    };
    let staged = refuse_each(&own, "write", write, |found| differs(found[..] != second[n - 10..]));
    assert!(staged >= 5, "{staged} pieces of staging memory");
    for spare in [0, 4096, 300_000, 3 << 20, 9 << 20] {
        own.set_memory_limit(used + spare);
        own.write(&buffer, 0, &second).unwrap();
        own.take_memory_peak();
        match own.read(&buffer) {
            Ok(found) => assert!(spare > 0 && found == second, "{spare} bytes"),
            Err(Error::OutOfDeviceMemory { .. }) => assert_eq!(spare, 0),
            Err(other) => panic!("{other}"),
        }
        assert!(own.take_memory_peak() <= used + spare, "{spare} bytes");
        own.set_memory_limit(u64::MAX);
        own.write(&buffer, 0, &first).unwrap();
        assert!(own.read(&buffer).unwrap() == first);
        assert_eq!(own.memory_used(), used);
    }
    // A quarter of what is read is enough, and no more is taken.
    own.take_memory_peak();
    let large = own.upload("more words", &words((128 << 20) / 4)).unwrap();
    assert!(own.take_memory_peak() <= used + large.bytes() * 5 / 4);
    own.read(&large).unwrap();
    assert!(own.take_memory_peak() <= used + large.bytes() * 5 / 4);
}

fn threads_transfer_at_the_same_time(gpu: &Gpu) {
    let own = own_context(gpu);
    std::thread::scope(|scope| {
        for thread in 0..4u32 {
            let own = &own;
            scope.spawn(move || {
                for round in 0..3 {
                    let n = (3 << 20) / 4 + 1000 * thread as usize + 77 * round;
                    let data: Vec<u32> = (0..n as u32).map(|i| i.wrapping_mul(2 * thread + 3)).collect();
                    let buffer = own.upload("words of a thread", &data).unwrap();
                    assert!(own.read(&buffer).unwrap() == data, "thread {thread}, round {round}");
                }
            });
        }
    });
    assert_eq!(own.memory_used(), 0);
}

fn values_come_with_the_work(gpu: &Gpu) {
    let (a, b) = (gpu.upload("a", &words(1000)).unwrap(), gpu.upload("b", &[1u32; 1000]).unwrap());
    let empty: Buffer<u32> = gpu.buffer("empty", 0).unwrap();
    let bytes = gpu.upload("bytes", &[1u8, 2, 3]).unwrap();
    let mut commands = gpu.commands("copy and read");
    let before = commands.stage("copies").read_back(&b).unwrap();
    commands.copy(&a, &b);
    let after = commands.read_back(&b).unwrap();
    let nothing = commands.read_back(&empty).unwrap();
    let odd = commands.read_back(&bytes).unwrap();
    let too_early = before.values();
    assert!(matches!(too_early, Err(Error::Device { .. })), "{too_early:?}");
    let times = commands.run().unwrap();
    assert_eq!(times.len(), 1);
    assert_eq!((before.values().unwrap(), after.values().unwrap()), (vec![1; 1000], words(1000)));
    assert_eq!((nothing.values().unwrap(), odd.values().unwrap()), (vec![], vec![1, 2, 3]));
    assert!(matches!(before.values(), Err(Error::Device { .. })), "values are taken once");
    // Also without waiting, and of the last of many repetitions.
    let mut commands = gpu.commands("repeated");
    let read = commands.copy(&b, &a).read_back(&a).unwrap();
    commands.submit_repeated(5).unwrap();
    assert_eq!(read.values().unwrap(), words(1000));
    // A context of its own does not take another's.
    let own = own_context(gpu);
    let mut commands = own.commands("foreign");
    let _ = commands.read_back(&a).unwrap();
    assert!(matches!(commands.run(), Err(Error::Device { .. })));
}

fn recorded_work_runs_again_with_new_values(gpu: &Gpu) {
    let (a, b): (Buffer<u32>, Buffer<u32>) = (gpu.buffer("a", 300).unwrap(), gpu.buffer("b", 300).unwrap());
    let mut commands = gpu.commands("again");
    let read = commands.copy(&a, &b).read_back(&b).unwrap();
    let recorded = commands.record().unwrap();
    let mut some = [0; 10];
    for round in 0..20u32 {
        gpu.write(&a, 0, &[round; 300]).unwrap();
        recorded.submit().unwrap();
        match round % 4 {
            // Values that nobody takes do no harm, before they are there or after.
            0 => {}
            1 => drop(gpu.read(&b).unwrap()),
            2 => assert_eq!(read.values().unwrap(), [round; 300]),
            _ => {
                read.take_into(&mut some).unwrap();
                assert_eq!(some, [round; 10]);
            }
        }
    }
    let more = read.take_into(&mut [0; 301]);
    assert!(matches!(more, Err(Error::LengthMismatch { .. })), "{more:?}");
}
