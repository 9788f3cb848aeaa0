//! Descriptions of robots are checked.

use didim::robot::{CoupledMotor, Friction, Joint, JointKind, Robot};

fn joint() -> Joint {
    Joint { kind: JointKind::Revolute, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 }
}

fn message(joints: Vec<Joint>, transmission: &[Vec<f64>], friction: Friction) -> String {
    Robot::new(joints, [0.0; 3], transmission, friction).unwrap_err().to_string()
}

#[test]
fn wrong_descriptions_say_what_is_wrong() {
    assert!(message(vec![], &[], Friction::sign(0)).contains("1 to 128 joints, got 0"));
    let singular = [vec![1.0, 1.0], vec![1.0, 1.0]];
    assert!(message(vec![joint(); 2], &singular, Friction::sign(2)).contains("singular"));
    let swapped = [vec![0.0, 1.0], vec![1.0, 0.0]];
    assert!(message(vec![joint(); 2], &swapped, Friction::sign(2)).contains("motor 1"));
    let mut bent = joint();
    bent.alpha = f64::NAN;
    assert!(message(vec![joint(), bent], &swapped, Friction::sign(2)).contains("alpha of joint 2"));
    let mut friction = Friction::sign(1);
    friction.dead_zone[0] = -0.1;
    assert!(message(vec![joint()], &[vec![1.0]], friction).contains("must not be negative, got -0.1"));
}

#[test]
fn numbers_and_lengths_are_checked_one_by_one() {
    let one = [vec![1.0]];
    let friction = |smoothing, dead_zone| Friction { smoothing, dead_zone, ..Friction::sign(1) };
    assert_eq!(
        message(vec![joint()], &one, friction(vec![0.0; 2], vec![0.0])),
        "smoothing needs 1 entries, one per joint, got 2"
    );
    assert_eq!(
        message(vec![joint()], &one, friction(vec![0.0], vec![f64::NAN])),
        "dead zone of joint 1 is not a finite number"
    );
    let transmission = |rows: &[Vec<f64>]| message(vec![joint(); 2], rows, Friction::sign(2));
    assert_eq!(transmission(&one), "transmission needs 2 entries, one per joint, got 1");
    assert_eq!(
        transmission(&[vec![1.0, 0.0], vec![1.0]]),
        "a row of transmission needs 2 entries, one per joint, got 1"
    );
    assert_eq!(
        transmission(&[vec![1.0, 0.0], vec![f64::NAN, 1.0]]),
        "transmission of joint 2 is not a finite number"
    );
    let weightless = Robot::new(vec![joint()], [0.0, f64::INFINITY, 0.0], &one, Friction::sign(1));
    assert_eq!(weightless.unwrap_err().to_string(), "gravity must be three finite numbers");
}

#[test]
fn a_coupled_wrist_is_found_and_scaled() {
    let robot =
        Robot::new(vec![joint(); 2], [0.0; 3], &[vec![45.0, 0.0], vec![32.0, 32.0]], Friction::sign(2))
            .unwrap();
    assert_eq!(robot.coupled(), &[CoupledMotor { motor: 1, others: vec![(0, 1.0)] }]);
    assert_eq!(robot.transmission(), &[vec![1.0, 0.0], vec![1.0, 1.0]]);
}
