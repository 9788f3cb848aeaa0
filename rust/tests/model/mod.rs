mod direct;
mod friction_terms;
mod identities;
mod inertia;
mod partials;
mod regressor;
mod trees;
