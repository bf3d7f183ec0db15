//! Windows of the program `terrane`, driven through the X protocol on virtual displays.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod driven;
mod one_window;
mod places;
mod views;
