mod filter;
mod observation;
mod text;
