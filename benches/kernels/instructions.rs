//! Instructions of the hottest kernels, counted by valgrind: `cargo bench -- --instructions`.
//!
//! The program runs itself under callgrind, once with some rounds of a kernel and once with twice as many. Start and set-up
//! are the same in both, so the difference belongs to the kernel alone, which is the code that `cargo bench` times. Counts do
//! not depend on the load of the machine; they depend on the compiler and on the instruction set that the core chooses.
//!
//! A program of our own: gungraun would bring 16 crates into every build of the tests, and a runner of 170.

use crate::tx40::{Batch, ClosedLoop, FEW, SAMPLES, STEPS};
use didim::ground::isa::Isa;
use std::env::current_exe;
use std::error::Error;
use std::process::{Command, Stdio};

/// callgrind counts an instruction that repeats itself once per byte, so the C library clears and copies memory without them.
const NO_REPEATS: &str =
    "glibc.cpu.x86_rep_stosb_threshold=0x40000000:glibc.cpu.x86_rep_movsb_threshold=0x40000000";

/// Options of callgrind where the sum alone is wanted.
const UNCOUNTED: [&str; 1] = ["--callgrind-out-file=/dev/null"];
/// Standard parameters of the TX40.
const PARAMETERS: usize = 86;
/// Bytes that a step reads whatever the number of lanes: a piece of the reference (two blocks of 24 coefficients), its knot, and the
/// measured positions and torques.
const STEP_READS: usize = 8 * (2 * 24 + 1 + 12);

/// A kernel, and how it is counted.
pub struct Kernel {
    pub name: &'static str,
    /// Unit of the count.
    pub unit: &'static str,
    /// Number of units in a round.
    pub units: usize,
    /// Rounds of the shorter run.
    pub rounds: usize,
    /// Bytes that a unit must read and write: its inputs and results, each once.
    pub bytes: f64,
    /// Sets up, and returns a round.
    pub set_up: fn() -> Box<dyn FnMut()>,
}

pub const KERNELS: [Kernel; 4] = [
    Kernel {
        name: "closed loop, 4 lanes",
        unit: "Runge-Kutta step and lane",
        units: STEPS * 4,
        rounds: 1,
        bytes: (STEP_READS / 4) as f64,
        set_up: || of(ClosedLoop::new(), |it| it.run::<4>()),
    },
    Kernel {
        name: "closed loop, 1 lane",
        unit: "Runge-Kutta step",
        units: STEPS,
        rounds: 1,
        bytes: STEP_READS as f64,
        set_up: || of(ClosedLoop::new(), |it| it.run::<1>()),
    },
    Kernel {
        name: "regressor",
        unit: "sample",
        units: FEW,
        rounds: 64,
        bytes: (8 * (18 + 6 * PARAMETERS)) as f64,
        set_up: || of(Batch::new(), Batch::regressor),
    },
    Kernel {
        name: "inverse dynamics",
        unit: "sample",
        units: SAMPLES,
        rounds: 4,
        bytes: (8 * (18 + 6)) as f64,
        set_up: || of(Batch::new(), Batch::inverse_dynamics),
    },
];

/// A round that calls `round` on `it`.
fn of<T: 'static>(mut it: T, round: fn(&mut T)) -> Box<dyn FnMut()> {
    Box::new(move || round(&mut it))
}

/// Instructions of this program under callgrind with `rounds` rounds of kernel `k`, and the instruction set that it reports.
///
/// `options` are further options of callgrind, one of which names the file of its counts.
pub fn count(k: usize, rounds: usize, options: &[&str]) -> Result<(u64, String), Box<dyn Error>> {
    let output = Command::new("valgrind")
        .arg("--tool=callgrind")
        .args(options)
        .arg(current_exe()?)
        .args(["--instructions", &k.to_string(), &rounds.to_string()])
        .env("GLIBC_TUNABLES", NO_REPEATS)
        .output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    // "==PID== Collected : 12345678"
    let collected = said.lines().find_map(|line| line.split_once("Collected : ")?.1.trim().parse().ok());
    match collected {
        Some(instructions) if output.status.success() => {
            Ok((instructions, String::from_utf8(output.stdout)?.trim().to_owned()))
        }
        _ => {
            eprint!("{said}");
            Err(format!("valgrind did not count: {}", output.status).into())
        }
    }
}

/// Does a program answer to `--version`?
pub fn installed(program: &str) -> bool {
    let probe = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    probe.is_ok_and(|status| status.success())
}

/// The code of up to four lanes that this processor gets.
pub fn instruction_set() -> &'static str {
    if cfg!(target_arch = "aarch64") { "Neon" } else { Isa::chosen().min(Isa::Avx2).name() }
}

/// Counts all kernels; as the child of a count, whose arguments are a kernel and a number of rounds, runs that kernel.
pub fn main(arguments: &[String]) -> Result<(), Box<dyn Error>> {
    if let [k, rounds] = arguments {
        println!("{}", instruction_set());
        let mut round = (KERNELS[k.parse::<usize>()?].set_up)();
        (0..rounds.parse()?).for_each(|_| round());
        return Ok(());
    }
    if !installed("valgrind") {
        println!("instructions are not counted: valgrind is not installed");
        return Ok(());
    }
    let mut processor = String::new();
    for (k, Kernel { name, unit, units, rounds, .. }) in KERNELS.iter().enumerate() {
        let (once, _) = count(k, *rounds, &UNCOUNTED)?;
        let (twice, said) = count(k, 2 * rounds, &UNCOUNTED)?;
        let each = (twice - once) as f64 / (rounds * units) as f64;
        println!("{name:<22}{each:>9.1} instructions per {unit}");
        processor = said;
    }
    println!("instruction set: {processor}");
    if processor != instruction_set() {
        println!(
            "valgrind hides the processor's own, {}: these counts are not of that code",
            instruction_set()
        );
    }
    Ok(())
}
