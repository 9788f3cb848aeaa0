//! Friction laws by tables.

use didim::robot::friction_terms::Table;

#[test]
fn a_table_passes_through_its_values_and_meets_smooth_laws() {
    let speeds: Vec<f64> = (0..201).map(|k| -2.0 + 0.02 * f64::from(k)).collect();
    let table = Table::new(-2.0, 0.02, speeds.iter().map(|v| (v / 0.3).atan()).collect()).unwrap();
    for v in &speeds {
        assert!((table.at(*v) - (v / 0.3).atan()).abs() < 1e-12);
        assert!((table.at(v + 0.007) - ((v + 0.007) / 0.3).atan()).abs() < 1e-4);
    }
    // The straight line goes on where the values end.
    let slope = (table.at(2.0) - table.at(1.9999)) / 1e-4;
    assert!((table.at(3.0) - table.at(2.0) - slope).abs() < 1e-4);
    assert_eq!(Table::new(0.0, 0.1, vec![0.0; 3]), None);
    assert_eq!(Table::new(0.0, 0.0, vec![0.0; 5]), None);
    assert_eq!(Table::new(0.0, 0.1, vec![0.0, 1.0, f64::NAN, 1.0]), None);
}
