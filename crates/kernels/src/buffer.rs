//! Output buffers that are not cleared first: every kernel writes all of its output.

/// `len` floats whose values are whatever was there.
#[must_use]
#[cfg(all(any(target_arch = "x86_64", target_arch = "aarch64"), not(miri)))]
pub(crate) fn buffer(len: usize) -> Vec<f32> {
    let mut values: Vec<f32> = Vec::with_capacity(len);
    // SAFETY: the capacity is there, and any bits are a float. The empty assembly may write to memory for all that the compiler knows, so that
    // what lies there counts as written, whatever it is: without it, reading an element before its kernel has written it would be undefined
    // behaviour and not just a wrong number.
    unsafe {
        std::arch::asm!("/* {0} */", in(reg) values.as_mut_ptr(), options(nostack, preserves_flags));
        values.set_len(len);
    }
    values
}

/// `len` floats, cleared where there is no way around it.
#[must_use]
#[cfg(not(all(any(target_arch = "x86_64", target_arch = "aarch64"), not(miri))))]
pub(crate) fn buffer(len: usize) -> Vec<f32> {
    vec![0.0; len]
}
