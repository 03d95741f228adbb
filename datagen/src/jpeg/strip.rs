//! Sixteen lines of a picture as luma and chroma, the unit in which JPEG with half-resolution colour proceeds.

/// Lines of a strip: as many as two blocks of luma, one of chroma.
pub const LINES: usize = 16;
/// Lines of samples: luma, then chroma at half the resolution, blue to the left of red.
const ROWS: usize = LINES + 8;

/// The samples of one strip: three rows of blocks of equal length, two of luma and one of chroma.
pub struct Strip {
    /// Pixels in a line, with those that fill the last blocks up.
    filled: usize,
    /// Samples from one row to the next: `filled`, rounded up to whole groups of blocks.
    pub stride: usize,
    samples: Vec<u8>,
    /// The channels of one line, apart.
    line: [Vec<u8>; 3],
}

impl Strip {
    /// For lines of `width` pixels, read in groups of `group` samples.
    pub fn new(width: usize, group: usize) -> Self {
        let filled = width.next_multiple_of(LINES);
        let stride = filled.next_multiple_of(group);
        Self { filled, stride, samples: vec![0; ROWS * stride], line: std::array::from_fn(|_| vec![0; filled]) }
    }

    /// Rows of blocks: luma, luma, chroma. Eight rows of `stride` samples each.
    #[inline(always)]
    pub fn block_rows(&self) -> std::slice::ChunksExact<'_, u8> {
        self.samples.chunks_exact(8 * self.stride)
    }

    /// Takes the lines from `first` on of a picture of red, green, blue; its last pixels are repeated beyond its border.
    #[inline(always)]
    pub fn fill(&mut self, rgb: &[u8], width: usize, first: usize) {
        let height = rgb.len() / (3 * width);
        let [red, green, blue] = &mut self.line;
        let (luma, chroma) = self.samples.split_at_mut(LINES * self.stride);
        for row in 0..LINES {
            let y = (first + row).min(height - 1);
            let pixels = rgb[3 * width * y..][..3 * width].as_chunks::<3>().0;
            for (((pixel, r), g), b) in pixels.iter().zip(&mut *red).zip(&mut *green).zip(&mut *blue) {
                [*r, *g, *b] = *pixel;
            }
            for channel in [&mut *red, &mut *green, &mut *blue] {
                let last = channel[width - 1];
                channel[width..].fill(last);
            }
            let out = &mut luma[row * self.stride..][..self.filled];
            for (((out, r), g), b) in out.iter_mut().zip(&*red).zip(&*green).zip(&*blue) {
                *out = weighted(*r, *g, *b, [19595, 38470, 7471], 0);
            }
            if row % 2 == 0 {
                let half = self.filled / 2;
                let (cb, cr) = chroma[row / 2 * self.stride..][..self.filled].split_at_mut(half);
                let (red, green, blue) = (red.as_chunks::<2>().0, green.as_chunks::<2>().0, blue.as_chunks::<2>().0);
                for ((((cb, cr), r), g), b) in cb.iter_mut().zip(cr).zip(red).zip(green).zip(blue) {
                    *cb = weighted(r[0], g[0], b[0], [-11059, -21709, 32768], 128);
                    *cr = weighted(r[0], g[0], b[0], [32768, -27439, -5329], 128);
                }
            }
        }
    }
}

/// A weighted sum in 65536ths, rounded, as JFIF defines luma and chroma.
#[inline(always)]
fn weighted(r: u8, g: u8, b: u8, weights: [i32; 3], offset: i32) -> u8 {
    ((weights[0] * i32::from(r) + weights[1] * i32::from(g) + weights[2] * i32::from(b) + (offset << 16) + 0x7fff) >> 16) as u8
}
