mod adjoint;
mod drives;
mod information;
mod partials;
