//! The network, losses and detections against reference data of the original Darknet (see the README there), where it is present:
//! in `../shared/golden` beside the workspace, or under `$TCROSS_SHARED`. Elsewhere these tests say that they are skipped.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod bad_input;
mod detections;
mod forward;
mod golden;
mod letterbox;
mod loss;
