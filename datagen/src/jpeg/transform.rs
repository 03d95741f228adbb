//! The cosine transform and the quantisation of eight blocks at once.
//!
//! Everything runs over *lanes* that lie side by side in memory and do the same, so that the compiler makes vectors of any width of it. A pass
//! of the transform along x has a lane for each row of each block, a pass along y one for each column; what stands between them, turning blocks over
//! their diagonals, is done with shifts and masks in words of 64 bits, a lane a word.
//!
//! The transform is that of Loeffler, Ligtenberg and Moschytz in the fixed-point form of the IJG's `jfdctint` ("islow"), to the bit.
use super::tables::{DIVISORS, ZIGZAG};

/// Blocks that are transformed together.
pub const BLOCKS: usize = 8;
/// Rows, or columns, of all of them.
const LANES: usize = 8 * BLOCKS;
/// Lanes of the left halves of the blocks, or of the upper ones.
const HALF: usize = LANES / 2;

/// Quantised coefficients of [`BLOCKS`] blocks.
pub struct Group {
    /// Of each row: columns 0 to 3 of every block, then columns 4 to 7 of every block.
    values: [[i16; LANES]; 8],
    /// Which of each column are not zero, a bit a row, in the same order.
    columns: [u8; LANES],
}

/// Where the coefficients of block 0 lie in a group, in the order in which they are written; those of block `b` lie `4 * b` further.
const PLACES: [u16; 64] = {
    let mut places = [0; 64];
    let mut k = 0;
    while k < 64 {
        let (row, column) = (ZIGZAG[k] as usize / 8, ZIGZAG[k] as usize % 8);
        places[k] = (row * LANES + column / 4 * HALF + column % 4) as u16;
        k += 1;
    }
    places
};

/// For each column: which coefficients, in the order in which they are written, are meant by a byte with a bit a row.
const ORDER: [[u64; 256]; 8] = {
    let mut order = [[0; 256]; 8];
    let mut k = 0;
    while k < 64 {
        let (row, column) = (ZIGZAG[k] as usize / 8, ZIGZAG[k] as usize % 8);
        let mut byte = 0;
        while byte < 256 {
            if byte >> row & 1 == 1 {
                order[column][byte] |= 1 << k;
            }
            byte += 1;
        }
        k += 1;
    }
    order
};

impl Group {
    /// All zero.
    pub fn new() -> Self {
        Self { values: [[0; LANES]; 8], columns: [0; LANES] }
    }

    /// The coefficient of a block at place `k` of the order in which they are written.
    #[inline(always)]
    pub fn value(&self, block: usize, k: usize) -> i16 {
        self.values.as_flattened()[usize::from(PLACES[k]) + 4 * block]
    }

    /// Which coefficients of a block are not zero, the first one written in the lowest bit.
    #[inline(always)]
    pub fn coded(&self, block: usize) -> u64 {
        (0..8).fold(0, |all, column| all | ORDER[column][usize::from(self.columns[column / 4 * HALF + 4 * block + column % 4])])
    }

    /// Transforms and quantises the blocks that begin at the left of `samples`, eight rows that are `stride` apart.
    #[inline(always)]
    pub fn transform(&mut self, samples: &[u8], stride: usize, quantiser: &Quantiser) {
        let rows: [&[u8; LANES]; 8] = std::array::from_fn(|y| samples[y * stride..].first_chunk().unwrap_or(&[0; LANES]));
        let along_x = pass_along_x(&turned_samples(rows));
        pass_along_y(&turned(&along_x), &mut self.values);
        quantiser.quantise(&mut self.values, &mut self.columns);
    }
}

/// Rows of samples to columns of samples, for each block: of column `x` rows 0 to 3 of every block, then rows 4 to 7 of every block.
#[inline(always)]
fn turned_samples(rows: [&[u8; LANES]; 8]) -> [[u8; LANES]; 8] {
    let mut words =
        rows.map(|row| std::array::from_fn::<u64, BLOCKS, _>(|b| row.as_chunks::<8>().0.get(b).map_or(0, |w| u64::from_le_bytes(*w))));
    // A square of 8 x 8 bytes is turned by exchanging quarters, quarters of quarters, and so on.
    exchange::<4, 32, 0x0000_0000_ffff_ffff, BLOCKS, 8>(&mut words);
    exchange::<2, 16, 0x0000_ffff_0000_ffff, BLOCKS, 8>(&mut words);
    exchange::<1, 8, 0x00ff_00ff_00ff_00ff, BLOCKS, 8>(&mut words);
    words.map(|column| {
        let mut out = [0; LANES];
        let (upper, lower) = out.split_at_mut(HALF);
        for ((word, upper), lower) in column.iter().zip(upper.as_chunks_mut::<4>().0).zip(lower.as_chunks_mut::<4>().0) {
            *upper = (*word as u32).to_le_bytes();
            *lower = ((*word >> 32) as u32).to_le_bytes();
        }
        out
    })
}

/// Columns to rows, for each block; both are kept with halves apart.
#[inline(always)]
fn turned(columns: &[[i16; LANES]; 8]) -> [[i16; LANES]; 8] {
    let mut rows = [[0; LANES]; 8];
    for from in 0..2 {
        for to in 0..2 {
            let mut words: [[u64; BLOCKS]; 4] = std::array::from_fn(|k| {
                let half = columns[4 * from + k][HALF * to..][..HALF].as_chunks::<4>().0;
                std::array::from_fn(|b| half.get(b).map_or(0, |w| w.iter().rev().fold(0, |word, v| word << 16 | u64::from(*v as u16))))
            });
            exchange::<2, 32, 0x0000_0000_ffff_ffff, BLOCKS, 4>(&mut words);
            exchange::<1, 16, 0x0000_ffff_0000_ffff, BLOCKS, 4>(&mut words);
            for (k, words) in words.iter().enumerate() {
                let half = rows[4 * to + k][HALF * from..][..HALF].as_chunks_mut::<4>().0;
                for (out, word) in half.iter_mut().zip(words) {
                    *out = std::array::from_fn(|i| (word >> (16 * i)) as i16);
                }
            }
        }
    }
    rows
}

/// Exchanges the high parts of the words of one row with the low parts of those `DISTANCE` rows below.
#[inline(always)]
fn exchange<const DISTANCE: usize, const SHIFT: u32, const LOW: u64, const N: usize, const ROWS: usize>(words: &mut [[u64; N]; ROWS]) {
    for row in (0..ROWS).filter(|row| row & DISTANCE == 0) {
        let (above, below) = words.split_at_mut(row + DISTANCE);
        for (a, b) in above[row].iter_mut().zip(&mut below[0]) {
            let differ = ((*a >> SHIFT) ^ *b) & LOW;
            *a ^= differ << SHIFT;
            *b ^= differ;
        }
    }
}

/// The first pass: samples to values that are four times, and by another root of eight, too large.
#[inline(always)]
fn pass_along_x(columns: &[[u8; LANES]; 8]) -> [[i16; LANES]; 8] {
    let mut out = [[0; LANES]; 8];
    for lane in 0..LANES {
        let sums = cosines(std::array::from_fn(|x| i32::from(columns[x][lane]) - 128));
        for u in 0..8 {
            out[u][lane] = if u % 4 == 0 { sums[u] << PASS_BITS } else { rounded(sums[u], CONST_BITS - PASS_BITS) } as i16;
        }
    }
    out
}

/// The second pass: coefficients, eight times too large.
#[inline(always)]
fn pass_along_y(rows: &[[i16; LANES]; 8], out: &mut [[i16; LANES]; 8]) {
    for lane in 0..LANES {
        let sums = cosines(std::array::from_fn(|y| i32::from(rows[y][lane])));
        for v in 0..8 {
            out[v][lane] = rounded(sums[v], if v % 4 == 0 { PASS_BITS } else { CONST_BITS + PASS_BITS }) as i16;
        }
    }
}

/// Binary places of the constants below.
const CONST_BITS: u32 = 13;
/// Binary places that are kept from the first pass to the second.
const PASS_BITS: u32 = 2;

#[inline(always)]
fn rounded(value: i32, bits: u32) -> i32 {
    (value + (1 << (bits - 1))) >> bits
}

/// Eight samples to eight sums of cosines; all but the first and the fifth are larger by `CONST_BITS` places.
#[inline(always)]
fn cosines(s: [i32; 8]) -> [i32; 8] {
    let (t0, t1, t2, t3) = (s[0] + s[7], s[1] + s[6], s[2] + s[5], s[3] + s[4]);
    let (t7, t6, t5, t4) = (s[0] - s[7], s[1] - s[6], s[2] - s[5], s[3] - s[4]);
    let (t10, t11, t12, t13) = (t0 + t3, t1 + t2, t1 - t2, t0 - t3);
    let even = (t12 + t13) * 4433;
    let (z1, z2, z3, z4) = (t4 + t7, t5 + t6, t4 + t6, t5 + t7);
    let z5 = (z3 + z4) * 9633;
    let (z1, z2, z3, z4) = (z1 * -7373, z2 * -20995, z3 * -16069 + z5, z4 * -3196 + z5);
    [
        t10 + t11,
        t7 * 12299 + z1 + z4,
        even + t13 * 6270,
        t6 * 25172 + z2 + z3,
        t10 - t11,
        t5 * 16819 + z2 + z4,
        even - t12 * 15137,
        t4 * 2446 + z1 + z3,
    ]
}

/// Divides by whole numbers, rounding to the nearest, with a multiplication by the reciprocal.
pub struct Quantiser {
    /// The divisors, row by row, as the file holds them.
    pub divisors: [u8; 64],
    /// Added before the multiplication, a lane each: half the divisor.
    half: [[u16; LANES]; 8],
    /// The divisors' reciprocals in 65536ths.
    reciprocal: [[u16; LANES]; 8],
}

impl Quantiser {
    /// For luma (0) or chroma (1) at a quality of 1 to 100, by the IJG's scale.
    pub fn new(component: usize, quality: u8) -> Self {
        let quality = u32::from(quality.clamp(1, 100));
        let scale = if quality < 50 { 5000 / quality } else { 200 - quality * 2 };
        let divisors = DIVISORS[component].map(|d| ((u32::from(d) * scale + 50) / 100).clamp(1, 255) as u8);
        let (mut half, mut reciprocal) = ([[0; LANES]; 8], [[0; LANES]; 8]);
        for row in 0..8 {
            for lane in 0..LANES {
                let divisor = divisors[8 * row + lane / HALF * 4 + lane % 4];
                (half[row][lane], reciprocal[row][lane]) = divider(u16::from(divisor) * 8);
            }
        }
        Self { divisors, half, reciprocal }
    }

    #[inline(always)]
    fn quantise(&self, values: &mut [[i16; LANES]; 8], columns: &mut [u8; LANES]) {
        let mut coded = [0u16; LANES];
        for (row, values) in values.iter_mut().enumerate() {
            for lane in 0..LANES {
                let (value, sign) = (values[lane], values[lane] >> 15);
                let size = value.unsigned_abs() + self.half[row][lane];
                let size = ((u32::from(size) * u32::from(self.reciprocal[row][lane])) >> 16) as i16;
                values[lane] = (size ^ sign) - sign;
                coded[lane] |= u16::from(size != 0) << row;
            }
        }
        for (column, coded) in columns.iter_mut().zip(coded) {
            *column = coded as u8;
        }
    }
}

/// What to add to a number and what to multiply it with so that its upper 16 bits are its quotient by `divisor`, a multiple of 8.
fn divider(divisor: u16) -> (u16, u16) {
    let (quotient, rest, half) = (0x8000 / divisor, 0x8000 % divisor, divisor / 2);
    // The reciprocal has 15 places and is rounded; where it is rounded down, numbers just below a step are lifted over it.
    let (reciprocal, half) = match rest {
        0 => (quotient, half),
        rest if rest <= half => (quotient, half + 1),
        _ => (quotient + 1, half),
    };
    (half, 2 * reciprocal)
}
