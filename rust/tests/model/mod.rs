mod direct;
mod friction_terms;
mod identities;
mod inertia;
mod regressor;
mod trees;
