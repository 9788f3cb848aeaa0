//! Base parameters (7): the standard parameters that motion can tell apart, and how the others regroup into them.
//!
//! The columns of a regressor of random states are scanned from first to last, and a column that depends on those kept
//! so far is left out: of dependent parameters the one that comes first is kept. On the TX40 this keeps exactly
//! the 60 of Table II. Dependence is a matter of structure, so it is found on random states and not on a
//! log, whose filters could hide it. Friction has a structure at low speeds too: inside a dead zone its sign is zero, so that
//! `Fc+ - Fc-` is not the constant force of a slide along gravity. States at the speeds of each law therefore join the fast ones.
//!
//! The coefficients are polynomials in the lengths of the robot and the sines and cosines of its angles. They are
//! recognised on a twin robot with the same zeros and right angles but lengths and angles that no two joints
//! share, and then evaluated on the robot itself: exact numbers, with their text.

use super::symbols::{Dictionary, SNAP, number, twin};
use crate::model::regressor::regressor_under_load;
use crate::regression::least_squares::{self, Dependence, LeastSquaresError};
use crate::robot::friction_terms::{Law, Term as FrictionTerm};
use crate::robot::parameters::{Layout, Owner};
use crate::robot::{Followers, Robot};
use faer::Mat;

/// A column is dependent when what is left of it, scaled to unit norm, is below this. Rounding leaves up to 2e-10 of a column whose
/// regrouping passes through coefficients of a million, as in coupled trees with small factors; the next smallest was 4e-6 there.
const TOLERANCE: f64 = 1e-9;
/// Random states per standard parameter: enough rows to tell all columns apart.
const STATES_PER_PARAMETER: usize = 2;
/// Largest speed of the fast random states (rad/s or m/s).
const FASTEST: f64 = 3.0;

/// One term of a grouping: coefficient times a parameter that is not kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// Standard parameter that regroups.
    pub column: usize,
    /// Its coefficient.
    pub coefficient: f64,
    /// The coefficient as text: `""` for 1, `"d3^2"`, `"2 r4"`; a number where no symbol was recognised.
    pub symbol: String,
}

/// The base parameters of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Base {
    /// Standard parameters that are kept, in order.
    pub kept: Vec<usize>,
    /// For each kept parameter, the terms that regroup into it.
    pub terms: Vec<Vec<Term>>,
    /// Parameters that no motion shows: their columns are zero.
    pub unidentifiable: Vec<usize>,
}

/// Finds the base parameters of a robot.
pub fn base_parameters(robot: &Robot) -> Result<Base, LeastSquaresError> {
    let layout = Layout::of(robot);
    // What no state shows has a column of its own.
    let (tested, hidden): (Vec<usize>, Vec<usize>) = (layout.term(0)..layout.count())
        .partition(|&column| !is_hidden(robot, &robot.friction().terms[column - layout.term(0)]));
    let first = layout.term(0);
    let original = |column: usize| if column < first { column } else { tested[column - first] };
    let robot = &robot.with_terms(|term| !is_hidden(robot, term));
    let layout = Layout::of(robot);
    let own = dependences(robot)?;
    let twin = twin(robot).and_then(|twin| Some((dependences(&twin).ok()?, Dictionary::new(robot, &twin))));
    let count = layout.count();
    let joint = |column| match layout.owner(column) {
        Owner::Joint { joint, .. } => joint,
        Owner::Coupled { index, .. } => robot.coupled()[index].motor,
        Owner::Term { index } => robot.friction().terms[index].joint,
    };
    let mut terms: Vec<Vec<Term>> = vec![Vec::new(); count];
    let mut unidentifiable = Vec::new();
    let mut kept = vec![true; count];
    for dependence in &own {
        kept[dependence.column] = false;
        let mut regroups = false;
        for &(column, value) in &dependence.coefficients {
            if value.abs() < SNAP {
                continue;
            }
            regroups = true;
            let (coefficient, symbol) = twin
                .as_ref()
                .and_then(|(other, dictionary)| {
                    let found = other.iter().find(|other| other.column == dependence.column)?;
                    let target = found.coefficients.iter().find(|(kept, _)| *kept == column)?.1;
                    let (a, b) = (joint(column), joint(dependence.column));
                    dictionary.find((a.min(b), a.max(b)), target, value)
                })
                .unwrap_or_else(|| (value, number(value)));
            terms[column].push(Term { column: original(dependence.column), coefficient, symbol });
        }
        if !regroups {
            unidentifiable.push(original(dependence.column));
        }
    }
    let found = (0..count).filter(|&column| kept[column]);
    let mut all: Vec<(usize, Vec<Term>)> =
        found.map(|column| (original(column), std::mem::take(&mut terms[column]))).collect();
    all.extend(hidden.into_iter().map(|column| (column, Vec::new())));
    all.sort_by_key(|(column, _)| *column);
    let (kept, terms) = all.into_iter().unzip();
    Ok(Base { kept, terms, unidentifiable })
}

/// Does the column of a term depend on what a state does not have: the path, the temperature (a table of zeros at its reference), or
/// a rest that a simulation without dead zone does not know?
fn is_hidden(robot: &Robot, term: &FrictionTerm) -> bool {
    match &term.law {
        Law::Dahl { .. } => true,
        Law::Rest => robot.friction().dead_zone[term.joint] <= 0.0,
        Law::Table(table) => table.is_zero(),
        _ => false,
    }
}

/// Columns that depend on earlier ones, on random states; limb by limb, since limbs share neither rows nor columns.
fn dependences(robot: &Robot) -> Result<Vec<Dependence>, LeastSquaresError> {
    let n = robot.n_dof();
    let p = Layout::of(robot).count();
    // All that follows a joint is seen in its row, perhaps alone: as many states more as joints share a row.
    let sharing = |followers: &Followers, leader: usize| {
        let follows = |&joint: &usize| followers.leaders(joint).iter().any(|&(other, _)| other == leader);
        (0..robot.n_joints()).filter(follows).count()
    };
    let most = robot.followers().and_then(|all| (0..n).map(|leader| sharing(all, leader)).max()).unwrap_or(1);
    let samples = p * STATES_PER_PARAMETER * most / robot.n_joints() + 8;
    let (samples, flat) = regressor_of_states(robot, samples);
    let limbs = limbs(&flat, n, p);
    let zeros = (0..p).filter(|column| limbs.iter().all(|(_, columns)| !columns.contains(column)));
    let mut dependent: Vec<Dependence> =
        zeros.map(|column| Dependence { column, coefficients: Vec::new() }).collect();
    for (joints, columns) in limbs {
        let rows: Vec<usize> = (0..samples * n).filter(|row| joints.contains(&(row % n))).collect();
        let w = Mat::from_fn(rows.len(), columns.len(), |row, column| flat[rows[row] * p + columns[column]]);
        for own in least_squares::solve(w.as_ref(), &vec![0.0; rows.len()], TOLERANCE)?.dependent {
            let coefficients = own.coefficients.iter().map(|&(column, value)| (columns[column], value));
            dependent.push(Dependence { column: columns[own.column], coefficients: coefficients.collect() });
        }
    }
    dependent.sort_by_key(|dependence| dependence.column);
    Ok(dependent)
}

/// Joints and columns of each group of joints that shares no column with another, without columns of zeros; a single group has all
/// columns.
fn limbs(flat: &[f64], n: usize, p: usize) -> Vec<(Vec<usize>, Vec<usize>)> {
    let seen = |joint: usize, column: usize| {
        flat[joint * p + column..].iter().step_by(n * p).any(|value| *value != 0.0)
    };
    let joints: Vec<Vec<usize>> =
        (0..p).map(|column| (0..n).filter(|&joint| seen(joint, column)).collect()).collect();
    let mut group: Vec<usize> = (0..n).collect();
    for pair in joints.iter().flat_map(|all| all.windows(2)) {
        let (one, other) = (group[pair[0]], group[pair[1]]);
        group.iter_mut().filter(|each| **each == one.max(other)).for_each(|each| *each = one.min(other));
    }
    let whole = group.iter().all(|&each| each == 0);
    let of = |which: usize| {
        let own = |&column: &usize| whole || joints[column].first().is_some_and(|&j| group[j] == which);
        let columns: Vec<usize> = (0..p).filter(own).collect();
        ((0..n).filter(|&joint| group[joint] == which).collect(), columns)
    };
    (0..n).filter(|&joint| group[joint] == joint).map(of).filter(|(_, columns)| !columns.is_empty()).collect()
}

/// Number of random states, and their regressor: `samples` fast ones, and as many at the speeds of friction where it has any.
fn regressor_of_states(robot: &Robot, samples: usize) -> (usize, Vec<f64>) {
    let (n, p) = (robot.n_dof(), Layout::of(robot).count());
    let paces: Vec<Vec<f64>> = (0..n).map(|joint| paces(robot, joint)).collect();
    let all = if paces.iter().any(|own| own.len() > 1) { 2 * samples } else { samples };
    let random = Random::new(5 * n);
    let array = |offset: usize, scale: f64| {
        (0..all * n).map(|k| scale * random.entry(k / n, offset + k % n)).collect::<Vec<f64>>()
    };
    let (q, mut dq) = (array(0, std::f64::consts::PI), array(n, FASTEST));
    let (ddq, load) = (array(2 * n, 5.0), array(3 * n, 5.0));
    for k in samples * n..all * n {
        let own = &paces[k % n];
        // Each of its paces once in as many states, in an order that joints do not share.
        let (state, joint) = (k / n, k % n);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // between 0 and the number of paces
        let turn = (0.5 * (random.entry(state / own.len(), 4 * n + joint) + 1.0) * own.len() as f64) as usize;
        dq[k] *= own[(state + turn) % own.len()] / FASTEST;
    }
    let mut flat = vec![0.0; all * n * p];
    // A sign that is kept through rest has no dead zone.
    let kept = robot.with_signs_kept();
    let load = if kept.friction().has_load() { &load[..] } else { &[] };
    regressor_under_load(&kept, &q, &dq, &ddq, load, &mut flat).expect("the arrays were made for this robot");
    for (index, term) in robot.friction().terms.iter().enumerate() {
        let (joint, zone) = (term.joint, robot.friction().dead_zone[term.joint]);
        if term.law == Law::Rest && robot.friction().held[joint] > 0.0 {
            for row in (joint..all * n).step_by(n) {
                flat[row * p + Layout::of(robot).term(index)] = f64::from(u8::from(dq[row].abs() <= zone));
            }
        }
    }
    (all, flat)
}

/// Largest speeds of the random states of a driven joint: the usual one, and those at which its friction changes, inside its dead zone
/// and around it.
fn paces(robot: &Robot, driven: usize) -> Vec<f64> {
    let (friction, layout) = (robot.friction(), Layout::of(robot));
    let joint = (0..robot.n_joints()).find(|&joint| layout.number(joint) == driven).unwrap_or(driven);
    let curved = friction.terms.iter().filter(|term| term.joint == joint).filter_map(|term| match term.law {
        Law::Atan { velocity } | Law::Stribeck { velocity } => Some(velocity),
        _ => None,
    });
    let slow = curved.chain([friction.smoothing[joint]]).map(|velocity| 2.0 * velocity);
    let slow = slow.filter(|&pace| pace < FASTEST);
    let zone = friction.dead_zone[joint];
    [FASTEST].into_iter().chain(slow.chain([zone, 2.0 * zone]).filter(|&pace| pace > 0.0)).collect()
}

/// Numbers between -1 and 1, spread evenly: additive recurrences with the square roots of primes, which need no generator and are the
/// same everywhere.
struct Random(Vec<f64>);

impl Random {
    fn new(coordinates: usize) -> Self {
        let primes = (2u32..).filter(|k| (2..*k).all(|d| k % d != 0)).take(coordinates);
        Self(primes.map(|prime| f64::from(prime).sqrt()).collect())
    }

    fn entry(&self, sample: usize, coordinate: usize) -> f64 {
        (((sample + 1) as f64) * self.0[coordinate]).fract() * 2.0 - 1.0
    }
}
