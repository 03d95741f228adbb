//! Trains a detector: batches, augmentation, steps, checkpoints, curves.
