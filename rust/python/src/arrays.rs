//! Arrays at the border: shapes, finite numbers, copies only where the memory order asks for one.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::PyResult;
use pyo3::exceptions::PyValueError;
use std::borrow::Cow;

/// A two-dimensional array of doubles from Python, any strides.
pub type Input<'py> = PyReadonlyArray2<'py, f64>;

/// The shape that arrays of one call share.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Samples, rows.
    pub samples: usize,
    /// Joints, columns.
    pub width: usize,
}

impl Shape {
    /// Shape of `array`, which must have `width` columns.
    pub fn of(what: &str, array: &Input<'_>, width: usize) -> PyResult<Self> {
        let shape = array.shape();
        if shape[1] != width {
            let hint = if shape[0] == width { "; transpose it?" } else { "" };
            return Err(PyValueError::new_err(format!(
                "{what} must have shape (n_samples, {width}), got ({}, {}){hint}",
                shape[0], shape[1]
            )));
        }
        Ok(Self { samples: shape[0], width })
    }

    /// The numbers of `array`, which must have this shape.
    pub fn take<'a>(self, what: &str, array: &'a Input<'_>) -> PyResult<Cow<'a, [f64]>> {
        let shape = array.shape();
        if shape != [self.samples, self.width] {
            return Err(PyValueError::new_err(format!(
                "{what} must have the shape of q, ({}, {}), got ({}, {})",
                self.samples, self.width, shape[0], shape[1]
            )));
        }
        flat(what, array)
    }
}

/// The numbers of an array in row-major order, all finite.
pub fn flat<'a>(what: &str, array: &'a Input<'_>) -> PyResult<Cow<'a, [f64]>> {
    let width = array.shape()[1];
    // Any contiguous array has a slice, column-major ones too: only row-major numbers can be taken as they lie.
    let data = match array.as_slice() {
        Ok(slice) if array.is_c_contiguous() => Cow::Borrowed(slice),
        _ => Cow::Owned(array.as_array().iter().copied().collect()),
    };
    match data.iter().position(|value| !value.is_finite()) {
        None => Ok(data),
        Some(k) => Err(PyValueError::new_err(format!(
            "{what} is {} at sample {}, column {} (both from 1)",
            data[k],
            k / width + 1,
            k % width + 1
        ))),
    }
}

/// Two arrays of the same number of rows.
pub fn same_rows(what: &str, got: usize, other: &str, want: usize) -> PyResult<()> {
    if got == want {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{what} must have the {want} rows of {other}, got {got}")))
}
