//! Integration tests: the detector against Darknet's own boxes, runs over files, poses on drawn markers.
mod detector;
mod pose;
mod run;
#[allow(dead_code)]
mod scene;
