mod base;
mod consistent;
mod least_squares;
