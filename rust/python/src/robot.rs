//! Robots, for Python.

use super::wrong;
use didim::robot::friction_terms::{Cylinder, Law, Table, Term};
use didim::robot::parameters::{self, Layout};
use didim::robot::{Coupling, Follower, Friction, Joint, JointKind, Mount, Robot as CoreRobot};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A term of friction as Python gives it: joint from 0, name of its parameter, law, velocity (or width), and of a table the first
/// speed, the step and the values; of a cylinder its geometry as values.
type TermInput = (usize, String, String, f64, f64, Vec<f64>);

/// The part of a row that chains do without, as Python gives it: antecedent from 0 or None, gamma, b, shift.
type MountInput = (Option<usize>, f64, f64, [f64; 3]);

/// A joint that follows others, as Python gives it: leaders (from 0) with factors, and the offset.
type FollowerInput = (Vec<(usize, f64)>, f64);

fn friction_term((joint, name, law, velocity, step, values): TermInput) -> PyResult<Term> {
    let law = match law.as_str() {
        "rest" => Law::Rest,
        "atan" => Law::Atan { velocity },
        "stribeck" => Law::Stribeck { velocity },
        "root" => Law::Root,
        "forward" => Law::Forward,
        "load" => Law::Load,
        "dahl" => Law::Dahl { width: velocity },
        "table" => Law::Table(Table::new(velocity, step, values).ok_or_else(|| {
            PyValueError::new_err(format!(
                "friction term {name} of joint {}: a table needs at least 4 finite values and a step above 0",
                joint + 1
            ))
        })?),
        "spring" => Law::Spring,
        "sine" => Law::Sine,
        "cosine" => Law::Cosine,
        "cylinder" => Law::Cylinder(cylinder(&name, joint, &values)?),
        "cylinder_rate" => Law::CylinderRate(cylinder(&name, joint, &values)?),
        other => return Err(PyValueError::new_err(format!("no law of friction is called '{other}'"))),
    };
    Ok(Term { joint, law, name })
}

/// The cylinder of a term: `a`, `b`, `phi` and the length without force.
fn cylinder(name: &str, joint: usize, values: &[f64]) -> PyResult<Cylinder> {
    let made = if let &[a, b, phi, rest] = values { Cylinder::new(a, b, phi, rest) } else { None };
    made.ok_or_else(|| {
        PyValueError::new_err(format!(
            "spring {name} of joint {}: a cylinder needs finite a, b, phi and rest length, a and b above 0 and not the same",
            joint + 1
        ))
    })
}

/// A checked robot, immutable.
#[pyclass(frozen, module = "didim._core")]
pub(super) struct Robot(pub(super) CoreRobot);

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (*, kind, alpha, d, theta, r, gravity, transmission, asymmetric, printed_coupling, smoothing, dead_zone, held, terms=Vec::new(), mounts=None, followers=Vec::new()))]
    #[allow(clippy::too_many_arguments)] // one keyword each, called from one place in robot.py
    fn new(
        kind: Vec<u8>,
        alpha: Vec<f64>,
        d: Vec<f64>,
        theta: Vec<f64>,
        r: Vec<f64>,
        gravity: [f64; 3],
        transmission: Vec<Vec<f64>>,
        asymmetric: bool,
        printed_coupling: bool,
        smoothing: Vec<f64>,
        dead_zone: Vec<f64>,
        held: Vec<f64>,
        terms: Vec<TermInput>,
        mounts: Option<Vec<MountInput>>,
        followers: Vec<FollowerInput>,
    ) -> PyResult<Self> {
        let n = kind.len();
        for (what, list) in [("alpha", &alpha), ("d", &d), ("theta", &theta), ("r", &r)] {
            if list.len() != n {
                return Err(PyValueError::new_err(format!("{what} needs {n} entries, got {}", list.len())));
            }
        }
        let joints: Vec<Joint> = (0..n)
            .map(|j| Joint {
                kind: if kind[j] == 0 { JointKind::Revolute } else { JointKind::Prismatic },
                alpha: alpha[j],
                d: d[j],
                theta: theta[j],
                r: r[j],
            })
            .collect();
        let coupling = if printed_coupling { Coupling::Printed } else { Coupling::Shaft };
        let terms = terms.into_iter().map(friction_term).collect::<PyResult<_>>()?;
        let friction = Friction { asymmetric, coupling, smoothing, dead_zone, held, terms };
        let mounts = mounts.map_or_else(
            || Mount::chain(n),
            |mounts| {
                let mount = |(parent, gamma, b, shift)| Mount { parent, gamma, b, shift };
                mounts.into_iter().map(mount).collect()
            },
        );
        if followers.is_empty() {
            return CoreRobot::tree(joints, mounts, gravity, &transmission, friction)
                .map(Self)
                .map_err(wrong);
        }
        let followers: Vec<Follower> =
            followers.into_iter().map(|(leaders, offset)| Follower { leaders, offset }).collect();
        CoreRobot::with_followers(&joints, &mounts, gravity, &transmission, friction, &followers)
            .map(Self)
            .map_err(wrong)
    }

    #[getter]
    fn n_dof(&self) -> usize {
        self.0.n_dof()
    }

    #[getter]
    fn n_parameters(&self) -> usize {
        Layout::of(&self.0).count()
    }

    #[getter]
    fn parameter_names(&self) -> Vec<String> {
        parameters::names(&self.0)
    }

    #[getter]
    fn parameter_units(&self) -> Vec<&'static str> {
        parameters::units(&self.0)
    }
}
