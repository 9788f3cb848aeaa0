mod adjoint;
mod drives;
mod information;
