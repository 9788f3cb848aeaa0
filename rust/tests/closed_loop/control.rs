//! Controllers are checked; signals between their samples.

use crate::common::loops::PD;
use didim::closed_loop::control::{Controller, Digital, Law, Signal, Timing};
use didim::ground::arrays::MAX_DOF;

fn digital() -> Digital {
    Digital { period: 1e-3, delay: 0, smoothing: vec![1.0], resolution: vec![0.0; 2] }
}

#[test]
fn wrong_controllers_say_what_is_wrong() {
    let message = |second: Law, timing: Timing, feedforward: Option<Signal>| {
        Controller::new(vec![PD, second], timing, feedforward).unwrap_err().to_string()
    };
    let law = |second: Law| message(second, Timing::Continuous, None);
    assert_eq!(law(Law { velocity: f64::NAN, ..PD }), "the velocity gain of joint 2 is not a finite number");
    assert_eq!(
        law(Law { integrated_velocity: f64::INFINITY, ..PD }),
        "the integrator of joint 2 is not a finite number"
    );
    assert_eq!(law(Law { limit: 0.0, ..PD }), "the saturation of joint 2 must be positive, got 0");
    assert!(law(Law { limit: f64::NAN, ..PD }).starts_with("the saturation of joint 2"));
    assert!(law(Law { gain: 0.0, ..PD }).starts_with("the drive gain of joint 2 is zero"));
    let timing = |digital: Digital| message(PD, Timing::Digital(digital), None);
    assert!(timing(Digital { period: -1.0, ..digital() }).ends_with("must be positive, got -1"));
    let no_weights = timing(Digital { smoothing: vec![], ..digital() });
    assert_eq!(no_weights, "the smoothing of the velocity needs one or more finite weights");
    assert_eq!(timing(Digital { smoothing: vec![1.0, f64::NAN], ..digital() }), no_weights);
    assert!(timing(Digital { resolution: vec![0.0], ..digital() }).ends_with("one per joint, got 1"));
    let signal = |signal: Signal| message(PD, Timing::Continuous, Some(signal));
    assert_eq!(
        signal(Signal { rate: 1.0, n: 1, values: vec![0.0; 2] }),
        "the torque fed forward needs samples of 2 joints, got 1"
    );
    for (rate, value) in [(0.0, 0.0), (1.0, f64::NAN)] {
        assert_eq!(
            signal(Signal { rate, n: 2, values: vec![0.0, value] }),
            "the torque fed forward needs a positive rate and finite samples"
        );
    }
}

#[test]
fn a_signal_is_straight_between_its_samples_and_holds_beyond_them() {
    let signal = Signal { rate: 2.0, n: 2, values: vec![1.0, 10.0, 3.0, 20.0, -1.0, 0.0] };
    let mut out = [0.0; MAX_DOF];
    for (t, want) in [
        (-1.0, [1.0, 10.0]),
        (0.25, [2.0, 15.0]),
        (0.5, [3.0, 20.0]),
        (0.875, [0.0, 5.0]),
        (1.0, [-1.0, 0.0]),
        (9.0, [-1.0, 0.0]),
    ] {
        signal.at(t, &mut out);
        assert_eq!(out[..2], want, "{t}");
    }
    let one = Signal { rate: 2.0, n: 1, values: vec![4.0] };
    one.at(3.0, &mut out);
    assert_eq!(out[0], 4.0);
}

#[test]
fn only_a_digital_controller_has_a_period() {
    let of = |timing| Controller::new(vec![PD; 2], timing, None).unwrap().period();
    assert_eq!(of(Timing::Continuous), None);
    assert_eq!(of(Timing::Digital(digital())), Some(1e-3));
}
