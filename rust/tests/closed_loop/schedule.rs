//! Steps, records and control instants of a simulation.

use didim::closed_loop::point_to_point::PointToPoint;
use didim::closed_loop::reference::Reference;
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::robot::Robot;
use didim::robot::{Friction, Joint, JointKind};

fn robot() -> Robot {
    let joint = Joint { kind: JointKind::Prismatic, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
    Robot::new(vec![joint], [0.0; 3], &[vec![1.0]], Friction::sign(1)).unwrap()
}

/// 1 s at rest, 0 to 1 in 0.25 + 1.75 + 0.25 s, 1 s at rest.
fn reference() -> Reference {
    let moves = PointToPoint { points: &[0.0, 1.0], velocity: &[0.5], acceleration: &[2.0], dwell: 1.0 };
    Reference::point_to_point(1, moves).unwrap()
}

fn plan(slow: &[f64]) -> Plan<'_> {
    Plan { rate: 100.0, records: 426, period: None, coarse: 5e-3, fine: &[1e-3], slow, motion: None }
}

#[test]
fn segments_follow_each_other_and_end_with_the_last_record() {
    let schedule = Schedule::new(&robot(), &reference(), plan(&[0.05])).unwrap();
    let mut t = 0.0;
    for segment in schedule.segments() {
        assert!((segment.start - t).abs() < 1e-12);
        t = segment.start + segment.step * segment.steps as f64;
    }
    assert!((t - schedule.end()).abs() < 1e-12 && (t - 4.25).abs() < 1e-12);
    assert_eq!(schedule.segments().iter().filter(|s| s.record).count() + 1, 426);
    assert_eq!(schedule.divided(2).steps(), 2 * schedule.steps());
}

#[test]
fn rest_has_fine_steps_and_motion_coarse_ones() {
    let schedule = Schedule::new(&robot(), &reference(), plan(&[0.05])).unwrap();
    let step_at = |t: f64| schedule.segments().iter().rfind(|s| s.start <= t).map(|s| s.step).unwrap();
    assert!((step_at(0.5) - 1e-3).abs() < 1e-12);
    assert!((step_at(2.0) - 5e-3).abs() < 1e-12);
    assert!((step_at(4.0) - 1e-3).abs() < 1e-12);
    let coarse = Schedule::new(&robot(), &reference(), plan(&[0.0])).unwrap();
    assert_eq!(coarse.steps(), 850);
}

#[test]
fn the_motion_decides_where_steps_are_fine_and_the_joint_how_fine() {
    // The same 2.25 s of motion, half a second later than the reference; two joints, of which only the first moves.
    let joint = Joint { kind: JointKind::Prismatic, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
    let robot =
        Robot::new(vec![joint, joint], [0.0; 3], &[vec![1.0, 0.0], vec![0.0, 1.0]], Friction::sign(2))
            .unwrap();
    let moves = |dwell: f64| {
        let points = [0.0, 0.0, 1.0, 1.0];
        let moves = PointToPoint { points: &points, velocity: &[0.5; 2], acceleration: &[2.0; 2], dwell };
        Reference::point_to_point(2, moves).unwrap()
    };
    let (reference, motion) = (moves(1.0), moves(1.5));
    let plan = |fine, slow| Plan { fine, slow, motion: Some(&motion), ..plan(&[]) };
    let step_at = |schedule: &Schedule, t: f64| {
        schedule.segments().iter().rfind(|s| s.start <= t).map(|s| s.step).unwrap()
    };
    let schedule = Schedule::new(&robot, &reference, plan(&[2e-3, 1e-3], &[0.05, 0.0])).unwrap();
    // The reference moves, the motion does not yet; 5 ms are divided into steps of at most 2 ms.
    assert!((step_at(&schedule, 1.4) - 5e-3 / 3.0).abs() < 1e-12);
    assert!((step_at(&schedule, 2.0) - 5e-3).abs() < 1e-12);
    let both = Schedule::new(&robot, &reference, plan(&[2e-3, 1e-3], &[0.05, 0.05])).unwrap();
    assert!((step_at(&both, 1.4) - 1e-3).abs() < 1e-12);
    assert!(Schedule::new(&robot, &reference, plan(&[1e-3], &[0.05, 0.05])).is_err());
}

#[test]
fn records_and_controller_may_have_any_rates() {
    let plan = Plan { period: Some(0.003), ..plan(&[0.0]) };
    let schedule = Schedule::new(&robot(), &reference(), plan).unwrap();
    let controls: Vec<f64> = schedule.segments().iter().filter(|s| s.control).map(|s| s.start).collect();
    assert_eq!(controls.len() + usize::from(schedule.last_control()), 1417);
    assert!(controls.iter().enumerate().all(|(k, t)| (t - 0.003 * k as f64).abs() < 1e-9));
    assert!(schedule.segments().iter().all(|s| s.step <= 5e-3 + 1e-12 && s.step > 1e-7));
    // 0.03 s and its multiples are both.
    assert!(schedule.segments().iter().any(|s| s.record && s.control && (s.start - 0.03).abs() < 1e-12));
}

#[test]
fn wrong_plans_say_what_is_wrong() {
    let message = |plan: Plan<'_>| Schedule::new(&robot(), &reference(), plan).unwrap_err().to_string();
    assert!(
        message(Plan { records: 600, ..plan(&[0.0]) }).contains("ends at 4.25 s, before the run, at 5.99 s")
    );
    assert!(message(Plan { coarse: 0.0, ..plan(&[0.0]) }).contains("step must be positive, got 0"));
    assert!(message(Plan { fine: &[1e-15], ..plan(&[0.0]) }).contains("steps"));
    assert!(message(Plan { records: 1, ..plan(&[0.0]) }).contains("at least 2 records"));
}
