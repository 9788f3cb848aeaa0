//! How near the kernels are to the limit of the machine: `cargo bench -- --roofline`.
//!
//! A core can do so many arithmetic instructions a second and move so many bytes; both are measured here. The arithmetic instructions of a
//! kernel are counted by callgrind, address by address, and named by `objdump`. Its bytes are its arrays, read and written once. The arrays of
//! these benches stay in the second-level cache, so the larger of the two times there is the least that a kernel could take.

use crate::instructions::{KERNELS, count, installed, instruction_set};
use didim::ground::dispatch::{Kernel, WIDTH, dispatch};
use didim::ground::lanes::Set;
use std::collections::HashMap;
use std::env::{current_exe, temp_dir};
use std::error::Error;
use std::hint::black_box;
use std::process::Command;
use std::time::{Duration, Instant};

/// Time for which each measurement is repeated; the smallest of its repetitions counts.
const PATIENCE: Duration = Duration::from_secs(2);
/// Fused multiplications side by side, enough to hide their latency of four cycles and to stay in registers.
const CHAINS: usize = 12;
/// Rounds of the chains in one measurement.
const LINKS: usize = 20_000;
/// Numbers of an array that no cache holds (128 MB), and of one that the second-level cache holds (256 kB).
const SIZES: [usize; 2] = [1 << 24, 1 << 15];

/// Independent chains of fused multiplications on vectors.
struct Multiplications;

impl Kernel for Multiplications {
    type Output = ();
    #[inline(always)]
    fn run<V: Set>(self) {
        let (factor, term) = (black_box(0.999_f64), black_box(1e-3));
        let mut chains = [[black_box(1.0_f64); WIDTH]; CHAINS];
        for _ in 0..LINKS {
            for chain in &mut chains {
                for number in chain {
                    *number = number.mul_add(factor, term);
                }
            }
        }
        black_box(chains);
    }
}

/// Smallest time of a call (s) in [`PATIENCE`].
fn smallest(mut work: impl FnMut()) -> f64 {
    let (begin, mut smallest) = (Instant::now(), f64::INFINITY);
    while begin.elapsed() < PATIENCE {
        let start = Instant::now();
        work();
        smallest = smallest.min(start.elapsed().as_secs_f64());
    }
    smallest
}

/// Bytes a second of a copy of so many numbers, read and written.
fn bandwidth(numbers: usize) -> f64 {
    let (from, mut to) = (vec![1.0_f64; numbers / 2], vec![0.0_f64; numbers / 2]);
    (8 * numbers) as f64 / smallest(|| black_box(&mut to).copy_from_slice(black_box(&from)))
}

/// Arithmetic instructions in a unit of a kernel, and floating-point operations in them.
#[derive(Default)]
struct Arithmetic {
    instructions: f64,
    operations: f64,
}

/// How often each address of this program was executed in so many rounds.
fn executed(k: usize, rounds: usize) -> Result<HashMap<u64, u64>, Box<dyn Error>> {
    let file = temp_dir().join(format!("didim-roofline-{}", std::process::id()));
    let out = format!("--callgrind-out-file={}", file.display());
    let plain = ["--compress-strings=no", "--compress-pos=no", "--dump-line=no", "--dump-instr=yes"];
    count(k, rounds, &[&[&*out], &plain[..]].concat())?;
    let (text, program) = (std::fs::read_to_string(&file)?, current_exe()?);
    std::fs::remove_file(&file)?;
    let (mut counts, mut ours, mut inclusive) = (HashMap::new(), false, false);
    for line in text.lines() {
        if let Some(object) = line.strip_prefix("ob=") {
            ours = object == program.to_string_lossy();
        } else if line.starts_with("calls=") {
            inclusive = true; // the next line is the cost of what is called
        } else if let Some((address, cost)) = line.strip_prefix("0x").and_then(|rest| rest.split_once(' ')) {
            if ours && !std::mem::take(&mut inclusive) {
                *counts.entry(u64::from_str_radix(address, 16)?).or_default() += cost.parse::<u64>()?;
            }
            inclusive = false;
        }
    }
    Ok(counts)
}

/// Floating-point operations of each instruction of this program that does any: its address and their number.
fn operations() -> Result<HashMap<u64, f64>, Box<dyn Error>> {
    let output = Command::new("objdump").args(["-d", "--no-show-raw-insn"]).arg(current_exe()?).output()?;
    let mut operations = HashMap::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let Some((address, rest)) = line.trim_start().split_once(":\t") else { continue };
        let (name, operands) = rest.split_once(' ').unwrap_or((rest, ""));
        let name = name.strip_prefix('v').unwrap_or(name);
        let (vector, scalar) = (name.ends_with("pd"), name.ends_with("sd"));
        let fused = name.starts_with("fmadd") || name.starts_with("fmsub") || name.starts_with("fnm");
        let plain = ["add", "sub", "mul", "div", "sqrt"].iter().any(|known| name.starts_with(known));
        if (vector || scalar) && (fused || plain) {
            let lanes = match operands {
                _ if scalar => 1.0,
                wide if wide.contains("%zmm") => 8.0,
                wide if wide.contains("%ymm") => 4.0,
                _ => 2.0,
            };
            operations.insert(u64::from_str_radix(address, 16)?, lanes * if fused { 2.0 } else { 1.0 });
        }
    }
    Ok(operations)
}

/// Prints what a core can do, and a row for each kernel.
pub fn main() -> Result<(), Box<dyn Error>> {
    if !cfg!(target_arch = "x86_64") || !installed("valgrind") || !installed("objdump") {
        println!("the roofline needs an x86-64 processor, valgrind and objdump");
        return Ok(());
    }
    let rate = (CHAINS * LINKS) as f64 / smallest(|| dispatch(Multiplications));
    let [memory, cache] = SIZES.map(bandwidth);
    println!("instruction set: {}", instruction_set());
    println!("a core: {:.2} fused multiplications of vectors a ns", 1e-9 * rate);
    println!(
        "a core: {:.1} bytes a ns from memory, {:.1} from the second-level cache",
        1e-9 * memory,
        1e-9 * cache
    );
    println!(
        "{:22}{:>12}{:>8}{:>8}{:>12}{:>10}{:>11}{:>8}{:>8}",
        "", "arithmetic", "flop", "bytes", "ns to do it", "in cache", "in memory", "ns", "reached"
    );
    let operations = operations()?;
    for (k, kernel) in KERNELS.iter().enumerate() {
        let (once, twice) = (executed(k, kernel.rounds)?, executed(k, 2 * kernel.rounds)?);
        let units = (kernel.rounds * kernel.units) as f64;
        let mut needs = Arithmetic::default();
        for (address, operations) in &operations {
            let count = |of: &HashMap<u64, u64>| of.get(address).copied().unwrap_or(0) as f64;
            let each = (count(&twice) - count(&once)) / units;
            needs.instructions += each;
            needs.operations += each * operations;
        }
        let mut round = (kernel.set_up)();
        let time = 1e9 * smallest(&mut round) / kernel.units as f64;
        let flop = 1e9 * needs.instructions / rate;
        let [in_memory, in_cache] = [memory, cache].map(|bandwidth| 1e9 * kernel.bytes / bandwidth);
        println!(
            "{:22}{:>12.0}{:>8.0}{:>8.0}{flop:>12.1}{in_cache:>10.1}{in_memory:>11.1}{time:>8.1}{:>7.0}%  per {}",
            kernel.name,
            needs.instructions,
            needs.operations,
            kernel.bytes,
            100.0 * flop.max(in_cache) / time,
            kernel.unit,
        );
    }
    Ok(())
}
