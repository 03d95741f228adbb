//! Safe code, compiled anew for the widest integer vectors that the machine has.

/// Plain safe code without any instruction set in it: loops over slices and arrays that the compiler turns into vectors.
pub trait Portable {
    /// What it makes.
    type Output;

    /// Does it. To be marked `#[inline(always)]`, and so must be all that it calls in its loops: what is not inlined stays compiled for the
    /// compiler's baseline.
    fn run(self) -> Self::Output;
}

/// Runs `work`, compiled for AVX-512, for AVX2 or for the compiler's baseline, whichever is the best of this machine. Integers give the same
/// result on every machine, and so do floats, as Rust neither fuses nor reorders them.
///
/// ```
/// use tcross_kernels::simd::{Portable, widest};
/// struct Double<'a>(&'a mut [u16]);
/// impl Portable for Double<'_> {
///     type Output = ();
///     #[inline(always)]
///     fn run(self) {
///         self.0.iter_mut().for_each(|v| *v *= 2);
///     }
/// }
/// let mut values = [1, 2, 3];
/// widest(Double(&mut values));
/// assert_eq!(values, [2, 4, 6]);
/// ```
pub fn widest<W: Portable>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi,avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx512<W: Portable>(work: W) -> W::Output {
            work.run()
        }
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx2<W: Portable>(work: W) -> W::Output {
            work.run()
        }
        macro_rules! all {
            ($($feature:tt),*) => { $(is_x86_feature_detected!($feature))&&* };
        }
        if all!("avx2", "bmi1", "bmi2", "lzcnt", "popcnt") {
            return if all!("avx512f", "avx512bw", "avx512dq", "avx512vl", "avx512vbmi") {
                // SAFETY: every instruction set that is enabled was just found on this machine.
                unsafe { avx512(work) }
            } else {
                // SAFETY: as above.
                unsafe { avx2(work) }
            };
        }
    }
    work.run()
}
