//! Coefficients of regroupings as text: polynomials in the lengths of a robot and the sines and cosines of its angles.
//!
//! They are recognised on a twin robot with the same zeros and right angles but lengths and angles that no two joints
//! share, and then evaluated on the robot itself: exact numbers. Tested in `base.rs`.

use crate::robot::parameters::Layout;
use crate::robot::{Joint, JointKind, Mount, Robot, Twist};

/// A coefficient below this is rounding; a symbol within this of a coefficient is it. Products of small sines reach 1e-9.
pub(super) const SNAP: f64 = 1e-10;
/// Largest number of monomials, before their factors, of the joints between two links.
const LARGEST_SPAN: usize = 100;
/// A robot with the same zeros and right angles, and generic values elsewhere.
pub(super) fn twin(robot: &Robot) -> Option<Robot> {
    let generic = |value: f64, index: usize| {
        if value == 0.0 { 0.0 } else { 0.3 + (((index + 1) as f64) * 2.0_f64.sqrt()).fract() * 0.7 }
    };
    let joints = robot
        .joints()
        .iter()
        .enumerate()
        .map(|(j, joint)| Joint {
            alpha: match robot.placements()[j].twist {
                Twist::General(..) => generic(1.0, 5 * j),
                _ => joint.alpha,
            },
            d: generic(joint.d, 5 * j + 1),
            r: generic(joint.r, 5 * j + 2),
            theta: if joint.kind == JointKind::Prismatic && right(joint.theta).is_none() {
                generic(1.0, 5 * j + 3)
            } else {
                joint.theta
            },
            ..*joint
        })
        .collect();
    let mounts = robot.mounts().iter().enumerate().map(|(j, mount)| Mount {
        gamma: if right(mount.gamma).is_none() { generic(1.0, 1000 + 2 * j) } else { mount.gamma },
        b: generic(mount.b, 1001 + 2 * j),
        ..*mount
    });
    robot.with_rows(joints, mounts.collect()).ok()
}

fn right(angle: f64) -> Option<f64> {
    let quarter = (angle / std::f64::consts::FRAC_PI_2).round();
    ((angle - quarter * std::f64::consts::FRAC_PI_2).abs() < 1e-12).then_some(quarter)
}

/// A symbol of the geometry, its text, and its value on the robot and on its twin.
#[derive(Debug, Clone)]
struct Symbol {
    text: String,
    value: f64,
    twin: f64,
}

/// Polynomials of the geometry, ready to be looked up by their value on the twin.
///
/// Most coefficients are of one joint's geometry, because a link regroups into the one before it and so on inwards; the
/// others are looked for among the joints between, where those are few. What is not found stays a number.
pub(super) struct Dictionary {
    /// Monomials of each joint, then those of pairs of joints `(a, b]` that are not too many; sorted by twin value.
    joints: Vec<Vec<Symbol>>,
    spans: Vec<((usize, usize), Vec<Symbol>)>,
}

impl Dictionary {
    pub(super) fn new(robot: &Robot, twin: &Robot) -> Self {
        let n = robot.n_joints();
        let symbols: Vec<(Vec<Symbol>, Vec<Symbol>)> = (0..n).map(|j| symbols(robot, twin, j)).collect();
        let joints = (0..n).map(|j| monomials(&symbols[j..=j])).collect();
        let mut spans = Vec::new();
        for a in 0..n {
            for b in a + 2..n {
                let size = |pick: fn(&(Vec<Symbol>, Vec<Symbol>)) -> usize| {
                    let count = symbols[a + 1..=b].iter().map(pick).sum::<usize>();
                    1 + count + count * (count + 1) / 2
                };
                if size(|s| s.0.len()) * size(|s| s.1.len()) <= LARGEST_SPAN {
                    spans.push(((a, b), monomials(&symbols[a + 1..=b])));
                }
            }
        }
        Self { joints, spans }
    }

    /// The coefficient `target` of the twin, `value` of the robot, between joints `a` and `b`: a sum of at most two monomials.
    pub(super) fn find(&self, (a, b): (usize, usize), target: f64, value: f64) -> Option<(f64, String)> {
        let span = self.spans.iter().find(|(ends, _)| *ends == (a, b)).map(|(_, symbols)| symbols);
        let lists = || self.joints[(a + 1).min(b)..=b].iter().chain(span);
        lists()
            .find_map(|list| single(list, target, value))
            .or_else(|| lists().find_map(|list| pair(list, target, value)))
    }
}

/// The symbols near `target` in a sorted list.
fn near(list: &[Symbol], target: f64) -> &[Symbol] {
    let first = list.partition_point(|symbol| symbol.twin < target - SNAP);
    let last = list.partition_point(|symbol| symbol.twin <= target + SNAP);
    &list[first..last]
}

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() < SNAP * (1.0 + b.abs())
}

fn single(list: &[Symbol], target: f64, value: f64) -> Option<(f64, String)> {
    near(list, target).iter().find(|m| same(m.value, value)).map(|m| (m.value, m.text.clone()))
}

fn pair(list: &[Symbol], target: f64, value: f64) -> Option<(f64, String)> {
    list.iter().find_map(|first| {
        let second = near(list, target - first.twin).iter().find(|m| same(first.value + m.value, value))?;
        // A sum opens with its positive term, and with the shorter of two positive ones.
        let key = |m: &Symbol| (m.text.starts_with('-'), m.text.len(), m.text.clone());
        let (first, second) = if key(first) <= key(second) { (first, second) } else { (second, first) };
        let text = match second.text.strip_prefix('-') {
            Some(rest) => format!("({} - {})", or_one(&first.text), or_one(rest)),
            None => format!("({} + {})", or_one(&first.text), or_one(&second.text)),
        };
        Some((first.value + second.value, text))
    })
}

fn or_one(text: &str) -> &str {
    match text {
        "" => "1",
        "-" => "-1",
        text => text,
    }
}

/// Lengths, and sines and cosines of angles, of one joint.
fn symbols(robot: &Robot, twin: &Robot, j: usize) -> (Vec<Symbol>, Vec<Symbol>) {
    let (own, other) = (&robot.joints()[j], &twin.joints()[j]);
    let (mount, moved) = (&robot.mounts()[j], &twin.mounts()[j]);
    let number = Layout::of(robot).number(j) + 1;
    let lengths = [("d", own.d, other.d), ("r", own.r, other.r), ("b", mount.b, moved.b)]
        .into_iter()
        .filter(|(_, value, _)| *value != 0.0)
        .map(|(name, value, twin)| Symbol { text: format!("{name}{number}"), value, twin })
        .collect();
    let mut angles = Vec::new();
    if let Twist::General(c, s) = robot.placements()[j].twist {
        let (ct, st) = twin.placements()[j].twist.cos_sin();
        angles.push(Symbol { text: format!("cos(alpha{number})"), value: c, twin: ct });
        angles.push(Symbol { text: format!("sin(alpha{number})"), value: s, twin: st });
    }
    let theta = (own.kind == JointKind::Prismatic).then_some(("theta", own.theta, other.theta));
    for (angle, value, twin) in theta.into_iter().chain([("gamma", mount.gamma, moved.gamma)]) {
        if right(value).is_some() {
            continue;
        }
        for (name, f) in [("cos", f64::cos as fn(f64) -> f64), ("sin", f64::sin)] {
            let text = format!("{name}({angle}{number})");
            angles.push(Symbol { text, value: f(value), twin: f(twin) });
        }
    }
    (lengths, angles)
}

/// Multiples by 1, -1, 2, -2 of products of up to two lengths and up to two sines or cosines, sorted by twin value.
fn monomials(symbols: &[(Vec<Symbol>, Vec<Symbol>)]) -> Vec<Symbol> {
    let lengths: Vec<Symbol> = symbols.iter().flat_map(|s| s.0.iter().cloned()).collect();
    let angles: Vec<Symbol> = symbols.iter().flat_map(|s| s.1.iter().cloned()).collect();
    let mut all = Vec::new();
    for length in products(&lengths) {
        for angle in products(&angles) {
            for (factor, text) in [(1.0, ""), (-1.0, "-"), (2.0, "2 "), (-2.0, "-2 ")] {
                let body = [length.text.as_str(), angle.text.as_str()];
                let body = body.iter().filter(|part| !part.is_empty()).copied().collect::<Vec<_>>().join(" ");
                all.push(Symbol {
                    text: if body.is_empty() { text.trim().to_string() } else { format!("{text}{body}") },
                    value: factor * length.value * angle.value,
                    twin: factor * length.twin * angle.twin,
                });
            }
        }
    }
    all.sort_by(|a, b| a.twin.total_cmp(&b.twin));
    all
}

/// 1, each symbol, and each product of two.
fn products(symbols: &[Symbol]) -> Vec<Symbol> {
    let mut all = vec![Symbol { text: String::new(), value: 1.0, twin: 1.0 }];
    all.extend(symbols.iter().cloned());
    for (k, first) in symbols.iter().enumerate() {
        for (l, second) in symbols[k..].iter().enumerate() {
            all.push(Symbol {
                text: if l == 0 {
                    format!("{}^2", first.text)
                } else {
                    format!("{} {}", first.text, second.text)
                },
                value: first.value * second.value,
                twin: first.twin * second.twin,
            });
        }
    }
    all
}

pub(super) fn number(value: f64) -> String {
    format!("{value:.9}").trim_end_matches('0').trim_end_matches('.').to_string()
}
