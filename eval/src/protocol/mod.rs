//! The three ways of scoring, one a file.
pub mod coco;
pub mod paper;
pub mod pose;
