mod cancel;
mod parallel;
