mod control;
mod laws;
mod memory;
mod reference;
mod schedule;
mod sensitivities;
mod shapes;
mod simulate;
