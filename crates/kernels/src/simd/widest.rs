//! Safe code, compiled anew for the widest vectors that the machine has.

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
    match Level::found().next_back() {
        Some(level) => level.run(work),
        None => work.run(),
    }
}

/// Runs what `make` makes for the baseline and then for each kind of wider vectors that this machine has: so that tests can see all do the same.
pub fn at_each_width<W: Portable>(mut make: impl FnMut() -> W) -> Vec<W::Output> {
    let baseline = make().run();
    std::iter::once(baseline).chain(Level::found().map(|level| level.run(make()))).collect()
}

/// Instruction sets beyond the baseline, which this machine has: only [`Self::found`] makes one.
#[derive(Clone, Copy)]
enum Level {
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// The narrow ones first.
    fn found() -> impl DoubleEndedIterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let all = [Self::Avx2, Self::Avx512];
        #[cfg(not(target_arch = "x86_64"))]
        let all: [Self; 0] = [];
        all.into_iter().filter(|level| level.is_here())
    }

    fn is_here(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        macro_rules! all {
            ($($feature:tt),*) => { $(is_x86_feature_detected!($feature))&&* };
        }
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => all!("avx2", "bmi1", "bmi2", "lzcnt", "popcnt"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => Self::Avx2.is_here() && all!("avx512f", "avx512bw", "avx512dq", "avx512vl", "avx512vbmi"),
        }
    }

    fn run<W: Portable>(self, work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi,avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx512<W: Portable>(work: W) -> W::Output {
            work.run()
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx2<W: Portable>(work: W) -> W::Output {
            work.run()
        }
        match self {
            // SAFETY: `found` has seen every instruction set that is enabled on this machine.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2(work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => unsafe { avx512(work) },
        }
    }
}
