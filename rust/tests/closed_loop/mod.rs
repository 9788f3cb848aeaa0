mod control;
mod laws;
mod reference;
mod schedule;
mod sensitivities;
mod shapes;
mod simulate;
