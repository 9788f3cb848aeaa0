mod description;
mod friction_terms;
mod parameters;
