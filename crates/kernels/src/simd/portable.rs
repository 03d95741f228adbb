//! Plain arrays of eight, which the compiler turns into whatever vectors its target has.
use super::Simd;

#[derive(Clone, Copy)]
pub(crate) struct Portable;

macro_rules! lanes {
    ($k:ident => $e:expr) => {{
        let mut out = [0f32; 8];
        for ($k, o) in out.iter_mut().enumerate() {
            *o = $e;
        }
        out
    }};
}

// SAFETY (all methods): the trait's contract gives valid pointers; nothing else is needed.
impl Simd for Portable {
    type V = [f32; 8];
    const LANES: usize = 8;
    // 2 pixels x 2 vectors of 8 are 8 SSE registers of accumulators.
    const TILE: usize = 2;
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self::V {
        [value; 8]
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self::V {
        // SAFETY: see above; an array of f32 has the alignment of f32.
        unsafe { from.cast::<[f32; 8]>().read() }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f32, v: Self::V) {
        // SAFETY: see above.
        unsafe { to.cast::<[f32; 8]>().write(v) }
    }
    #[inline(always)]
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        lanes!(k => a[k] * b[k] + c[k])
    }
    #[inline(always)]
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V {
        lanes!(k => a[k] + b[k])
    }
    #[inline(always)]
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V {
        lanes!(k => a[k] - b[k])
    }
    #[inline(always)]
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V {
        lanes!(k => a[k] * b[k])
    }
    #[inline(always)]
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V {
        lanes!(k => if a[k] > b[k] { a[k] } else { b[k] })
    }
    #[inline(always)]
    unsafe fn leaky_factor(z: Self::V, slope: f32) -> Self::V {
        lanes!(k => if z[k] < 0.0 { slope } else { 1.0 })
    }
}
