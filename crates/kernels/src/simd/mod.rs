//! Vector instructions behind one trait, chosen at run time: AVX-512, AVX2 with FMA, or portable code.
//!
//! A kernel is written once, generic over [`Simd`] and `#[inline(always)]`; the [`dispatch!`] macro instantiates it inside a function
//! that is compiled for each instruction set and calls the best one the machine has. The same binary runs on all.
use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
pub(crate) mod avx2;
#[cfg(target_arch = "x86_64")]
pub(crate) mod avx512;
pub(crate) mod portable;
mod widest;

pub use widest::{Portable, at_each_width, widest};

/// A vector of `LANES` 32-bit floats and the few operations that the kernels need.
///
/// # Safety
/// Every method may only be called on a machine that has the instruction set of the implementor; pointers must be valid for
/// `LANES` floats (no alignment needed).
pub(crate) trait Simd: Copy {
    type V: Copy;
    /// Floats in a vector.
    const LANES: usize;
    /// Pixels in a tile of two vectors' width: as many accumulators as the registers hold.
    const TILE: usize;
    unsafe fn splat(value: f32) -> Self::V;
    unsafe fn load(from: *const f32) -> Self::V;
    unsafe fn store(to: *mut f32, v: Self::V);
    /// `a * b + c`, rounded once (portable: twice).
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V;
    /// 1 where the pre-activation is not negative, else the slope.
    unsafe fn leaky_factor(z: Self::V, slope: f32) -> Self::V;
}

/// An instruction set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Isa {
    /// Whatever the compiler's baseline is (SSE2 on x86-64, NEON on aarch64).
    Portable,
    /// AVX2 and FMA: eight floats.
    Avx2,
    /// AVX-512 F: sixteen floats.
    Avx512,
}

impl Isa {
    /// The best one of this machine.
    #[must_use]
    pub fn detect() -> Self {
        static ISA: OnceLock<Isa> = OnceLock::new();
        *ISA.get_or_init(|| Self::available().into_iter().next_back().unwrap_or(Self::Portable))
    }

    /// Every one that this machine can run, the best last.
    #[must_use]
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut found = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            found.push(Self::Avx2);
            if is_x86_feature_detected!("avx512f") {
                found.push(Self::Avx512);
            }
        }
        found
    }

    /// Floats in a vector.
    #[must_use]
    pub fn lanes(self) -> usize {
        match self {
            Self::Portable | Self::Avx2 => 8,
            Self::Avx512 => 16,
        }
    }

    /// The widest set, not above `self`, whose vectors `channels` fill: sixteen lanes on eight channels would compute eight for nothing.
    #[must_use]
    pub(crate) fn filled_by(self, channels: usize) -> Self {
        if self == Self::Avx512 && !channels.next_multiple_of(8).is_multiple_of(16) { Self::Avx2 } else { self }
    }
}

/// Calls `$body::<S>($args)` compiled for the instruction set `$isa`.
///
/// # Safety
/// As of `$body`; `$isa` must be one of [`Isa::available`].
macro_rules! dispatch {
    ($isa:expr, $body:ident :: <S $(, $g:ident)*> ( $($arg:ident : $ty:ty),* $(,)? ) $(-> $ret:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx2,fma")]
        #[allow(clippy::too_many_arguments)]
        unsafe fn avx512($($arg: $ty),*) $(-> $ret)? {
            // SAFETY: the caller of `dispatch!` keeps the contract of the body.
            unsafe { $body::<$crate::simd::avx512::Avx512>($($arg),*) }
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        #[allow(clippy::too_many_arguments)]
        unsafe fn avx2($($arg: $ty),*) $(-> $ret)? {
            // SAFETY: as above.
            unsafe { $body::<$crate::simd::avx2::Avx2>($($arg),*) }
        }
        assert!($isa <= $crate::simd::Isa::detect(), "{:?} is not there", $isa);
        // SAFETY: the instruction set is not above the best one detected on this machine, and each one includes those below it.
        unsafe {
            match $isa {
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Isa::Avx512 => avx512($($arg),*),
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Isa::Avx2 => avx2($($arg),*),
                _ => $body::<$crate::simd::portable::Portable>($($arg),*),
            }
        }
    }};
}
pub(crate) use dispatch;

/// The multiply-add peak of all threads in FLOP/s, measured now: twelve independent chains in registers, best of many short runs, so that a busy machine shows
/// its peak, too.
#[must_use]
pub fn measured_peak(isa: Isa) -> f64 {
    const STEPS: usize = 50_000;
    let mut best = f64::INFINITY;
    for _ in 0..200 {
        let start = std::time::Instant::now();
        rayon::broadcast(|_| std::hint::black_box(chains(isa, STEPS)));
        best = best.min(start.elapsed().as_secs_f64());
    }
    (2 * 12 * STEPS * isa.lanes() * rayon::current_num_threads()) as f64 / best
}

fn chains(isa: Isa, steps: usize) -> f32 {
    dispatch!(isa, chains_body::<S>(steps: usize) -> f32)
}

/// # Safety
/// None beyond the instruction set.
#[inline(always)]
unsafe fn chains_body<S: Simd>(steps: usize) -> f32 {
    // SAFETY: registers and a local array only.
    unsafe {
        let (a, b) = (S::splat(std::hint::black_box(0.999)), S::splat(std::hint::black_box(0.001)));
        let mut acc = [S::splat(1.0); 12];
        for (k, v) in acc.iter_mut().enumerate() {
            // Different starts, or the compiler would see twelve equal chains and run one.
            *v = S::splat(std::hint::black_box(k as f32));
        }
        for _ in 0..steps {
            for v in &mut acc {
                *v = S::fma(*v, a, b);
            }
        }
        let mut out = [0f32; 16];
        // Every chain counts, or the compiler would leave it out.
        S::store(out.as_mut_ptr(), acc.into_iter().reduce(|a, b| S::add(a, b)).unwrap_or(a));
        out[0]
    }
}
