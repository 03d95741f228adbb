//! Draws fiducial markers like a hand onto backgrounds, with exact truth.
