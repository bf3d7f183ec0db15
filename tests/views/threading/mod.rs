//! Which threads run what: the choice of threads and cores, and operations of the application.

mod choice;
mod operations;
