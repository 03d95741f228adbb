//! Output buffers that are not cleared first: every kernel writes all of its output.

/// `len` floats whose values are whatever was there.
#[must_use]
pub(crate) fn buffer(len: usize) -> Vec<f32> {
    let mut values: Vec<f32> = Vec::with_capacity(len);
    // SAFETY: the capacity is there, any bits are a float, and every caller hands the buffer to a kernel that writes each element before
    // anything reads one (`Finish::Accumulate` is never given a fresh buffer).
    #[allow(clippy::uninit_vec)]
    unsafe {
        values.set_len(len);
    }
    values
}
