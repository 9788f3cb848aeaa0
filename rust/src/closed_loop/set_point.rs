//! The set-point of a servo that limits its acceleration, between the goals of a command that is held from sample to sample.
//!
//! Each goal is headed for in the shortest time: with the largest acceleration, then with the largest deceleration, to rest there. One that
//! rests at a goal of two samples or more leaves it by a jump, some time after the command: steps of a real arm are met so. How servos plan is
//! not published; this is a model of it. Tested in `tests/test_positions.py`.

/// Time (s) from a new goal to the jump of a set-point that rests. Steps of 240 mrad by two joints of an SO-101, which chose it, have 26.8 and
/// 27.8 ms where no other delay is left; steps of a third have 36 ms together with its delay.
const SETS_OFF: f64 = 0.027;

/// Integrals from time 0 of the set-point at times (s), for goals at a rate (1/s) and a largest acceleration; before that it rests at the
/// first. Zeros without goals.
#[must_use]
pub fn areas(goals: &[f64], rate: f64, most: f64, times: &[f64]) -> Vec<f64> {
    if goals.is_empty() {
        return vec![0.0; times.len()];
    }
    let starts = starts(goals, rate, most);
    let at = |&time: &f64| {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // a time before the first goal is 0
        let k = ((time * rate).floor().max(0.0) as usize).min(goals.len() - 1);
        #[allow(clippy::cast_precision_loss)]
        let begin = k as f64 / rate;
        let (area, start) = starts[k];
        area + start.after(goals[k], most, time - begin).0
    };
    times.iter().map(at).collect()
}

/// Integrals of the set-point up to each sample, and how it is there.
fn starts(goals: &[f64], rate: f64, most: f64) -> Vec<(f64, Start)> {
    let (mut area, mut now) = (0.0, Start { s: goals[0], v: 0.0, waits: None });
    let (mut old, mut older) = (now.s, now.s);
    let mut states = Vec::with_capacity(goals.len());
    for &goal in goals {
        #[allow(clippy::float_cmp)] // a set-point that arrives is its goal, bit for bit
        let sets_off = now.waits.is_none() && now.v == 0.0 && now.s == old && old == older && goal != old;
        if sets_off {
            now.waits = Some(SETS_OFF);
        }
        states.push((area, now));
        let (more, next) = now.after(goal, most, 1.0 / rate);
        (area, now, older, old) = (area + more, next, old, goal);
    }
    states
}

/// Position and velocity of a set-point, and the time until it jumps, where it rests and will.
#[derive(Clone, Copy)]
struct Start {
    s: f64,
    v: f64,
    waits: Option<f64>,
}

impl Start {
    /// Integral over a time with one goal, and how the set-point is then; a jump is to the goal of its time.
    fn after(self, goal: f64, most: f64, time: f64) -> (f64, Self) {
        match self.waits {
            Some(waits) if waits > time => (self.s * time, Self { waits: Some(waits - time), ..self }),
            Some(waits) => (self.s * waits + goal * (time - waits), Self { s: goal, v: 0.0, waits: None }),
            None => {
                let (area, s, v) = fastest(goal, self.s, self.v, most, time);
                (area, Self { s, v, waits: None })
            }
        }
    }
}

/// Integral, position and velocity after a time of the fastest way from a state to rest at a goal.
fn fastest(goal: f64, s: f64, v: f64, most: f64, time: f64) -> (f64, f64, f64) {
    let ahead = goal - s - 0.5 * v * v.abs() / most;
    let way = if ahead == 0.0 { -v } else { ahead };
    let a = if way == 0.0 { 0.0 } else { way.signum() * most };
    let peak = (a * (goal - s) + 0.5 * v * v).max(0.0).sqrt();
    let x = time.min((peak - way.signum() * v) / most);
    let y = (time - x).clamp(0.0, peak / most);
    let rest = time - x - y;
    let faster = v + a * x;
    let turn = s + (v + 0.5 * a * x) * x;
    let area = (s + (0.5 * v + a * x / 6.0) * x) * x + (turn + (0.5 * faster - a * y / 6.0) * y) * y;
    if rest > 0.0 {
        return (area + goal * rest, goal, 0.0);
    }
    (area, turn + (faster - 0.5 * a * y) * y, faster - a * y)
}
