//! The forward pass, and the gradient of the input, which is one with other weights.
use super::{POINTS, SKEW, Tiles, Windows, transform};
use crate::{
    gather::{Finish, Gather, MIN_TASKS, SharedMut, Sums, finish_vector, run_tasks, with_scratch},
    pack::Panels,
    simd::{Simd, dispatch},
};
use std::ops::Range;

/// Floats of a task's transformed windows: half of a 512 KiB second-level cache.
const WINDOW_FLOATS: usize = 64 * 1024;
/// A task of fewer tiles would read the weights too often.
const LEAST_TILES: usize = 48;

/// Runs a convolution whose weights are packed as [`crate::pack::Form::Winograd`]; as [`Gather::run`].
pub(crate) fn run(gather: &Gather, out: &mut [f32]) -> Option<Vec<[f64; 2]>> {
    let [height, width, inputs] = gather.source_size;
    let weights = gather.groups[0].weights;
    assert!(gather.groups.len() == 1 && (gather.window, gather.step, gather.padding) == (3, 1, 1));
    assert!(gather.out_size == [height, width, weights.channels] && weights.k == inputs && weights.width == 2 * weights.isa.lanes());
    let tiles = Tiles { batch: gather.batch, height, width };
    let (rows, parts) = partition(&tiles, weights);
    let blocks = tiles.units().div_ceil(rows);
    let to = SharedMut(out.as_mut_ptr());
    let padded = weights.count() * weights.width;
    run_tasks(blocks * parts, gather.finish, weights.channels, padded, |task, sums| {
        let (block, part) = (task / parts, task % parts);
        let windows = Windows {
            isa: weights.isa,
            tiles,
            source: gather.source,
            channels: inputs,
            activation: gather.activation,
            units: block * rows..((block + 1) * rows).min(tiles.units()),
        };
        let count = windows.units.len() * tiles.columns();
        let (window_len, band_len) = windows.lens();
        let product_pitch = count * weights.width + SKEW;
        with_scratch(window_len + band_len.max(POINTS * product_pitch), |scratch| {
            // The band is read before the products are written.
            let (transformed, rest) = scratch.split_at_mut(window_len);
            windows.write(&mut rest[..band_len], transformed);
            let panels = weights.count();
            let work = Work {
                tiles,
                units: windows.units.clone(),
                windows: transformed,
                window_pitch: windows.pitch(),
                products: SharedMut(rest.as_mut_ptr()),
                product_pitch,
                weights,
                panels: part * panels / parts..(part + 1) * panels / parts,
                out: to,
                finish: gather.finish,
            };
            run_work(&work, sums);
        });
        windows.units.map(|unit| tiles.width * (height - 2 * (unit % tiles.rows())).min(2)).sum()
    })
}

/// Rows of tiles of a task, and parts that the panels of weights are cut into: functions of the shape alone.
fn partition(tiles: &Tiles, weights: &Panels) -> (usize, usize) {
    let (units, columns) = (tiles.units(), tiles.columns());
    let least = LEAST_TILES.div_ceil(columns);
    let mut rows = (WINDOW_FLOATS / (columns * POINTS * weights.k)).max(least).clamp(1, units);
    while units.div_ceil(rows) < MIN_TASKS && rows >= 2 * least {
        rows = rows.div_ceil(2);
    }
    rows = units.div_ceil(units.div_ceil(rows)); // tasks of equal size
    let mut parts = 1;
    while units.div_ceil(rows) * parts < MIN_TASKS && parts * 2 <= weights.count() {
        parts *= 2;
    }
    (rows, parts)
}

struct Work<'a> {
    tiles: Tiles,
    units: Range<usize>,
    /// `[point][tile][input]`.
    windows: &'a [f32],
    window_pitch: usize,
    /// `[point][tile][width]` of one panel.
    products: SharedMut,
    product_pitch: usize,
    weights: &'a Panels,
    panels: Range<usize>,
    out: SharedMut,
    finish: Finish<'a>,
}

fn run_work(work: &Work, sums: &mut [f32]) {
    dispatch!(work.weights.isa, work_body::<S>(work: &Work, sums: &mut [f32]))
}

/// # Safety
/// Scratch and output have the sizes that [`run`] gives them; the panels are packed for `S`.
#[inline(always)]
unsafe fn work_body<S: Simd>(work: &Work, sums: &mut [f32]) {
    for panel in work.panels.clone() {
        // SAFETY: passed on.
        unsafe {
            if work.weights.channels - panel * work.weights.width > S::LANES {
                panel_body::<S, 2>(work, panel, sums);
            } else {
                panel_body::<S, 1>(work, panel, sums);
            }
        }
    }
}

#[inline(always)]
unsafe fn panel_body<S: Simd, const V: usize>(work: &Work, panel: usize, sums: &mut [f32]) {
    let (inputs, width) = (work.weights.k, work.weights.width);
    let count = work.units.len() * work.tiles.columns();
    // SAFETY: every point has `count` rows of `inputs` windows and of `width` products, and `inputs` rows of weights.
    unsafe {
        let weights = work.weights.data.as_ptr().add(panel * POINTS * inputs * width);
        for point in 0..POINTS {
            multiply::<S, V>(
                work.windows.as_ptr().add(point * work.window_pitch),
                count,
                inputs,
                weights.add(point * inputs * width),
                width,
                work.products.at(point * work.product_pitch),
            );
        }
        outputs::<S, V>(work, panel, sums);
    }
}

/// `c = a b`: `a` is `[rows][inputs]`, `b` `[inputs][width]`, `c` `[rows][width]`, of which `V` vectors count.
#[inline(always)]
unsafe fn multiply<S: Simd, const V: usize>(a: *const f32, rows: usize, inputs: usize, b: *const f32, width: usize, c: *mut f32) {
    // Tiles of equal height, as high as the registers allow: a remainder of one row would cost as much as a whole tile.
    let most = if V == 1 { (2 * S::TILE).min(12) } else { S::TILE };
    let tiles = rows.div_ceil(most);
    let mut row = 0;
    for t in 1..=tiles {
        let next = t * rows / tiles;
        // SAFETY: passed on; the tile's rows are below `rows`.
        unsafe {
            let (a, c) = (a.add(row * inputs), c.add(row * width));
            match next - row {
                1 => product::<S, 1, V>(a, inputs, b, width, c),
                2 => product::<S, 2, V>(a, inputs, b, width, c),
                3 => product::<S, 3, V>(a, inputs, b, width, c),
                4 => product::<S, 4, V>(a, inputs, b, width, c),
                n if most >= 6 => match n {
                    5 => product::<S, 5, V>(a, inputs, b, width, c),
                    6 => product::<S, 6, V>(a, inputs, b, width, c),
                    n if most >= 12 => match n {
                        7 => product::<S, 7, V>(a, inputs, b, width, c),
                        8 => product::<S, 8, V>(a, inputs, b, width, c),
                        9 => product::<S, 9, V>(a, inputs, b, width, c),
                        10 => product::<S, 10, V>(a, inputs, b, width, c),
                        11 => product::<S, 11, V>(a, inputs, b, width, c),
                        _ => product::<S, 12, V>(a, inputs, b, width, c),
                    },
                    _ => unreachable!("a tile of six rows at most"),
                },
                _ => unreachable!("a tile of four rows at most"),
            }
        }
        row = next;
    }
}

#[inline(always)]
unsafe fn product<S: Simd, const P: usize, const V: usize>(a: *const f32, inputs: usize, b: *const f32, width: usize, c: *mut f32) {
    // SAFETY: `P` rows of `inputs`, `inputs` rows of `width`, `P` rows of `width`.
    unsafe {
        let mut acc = [[S::splat(0.0); V]; P];
        // One address for three rows: with twelve the general registers would not suffice.
        let mut rows = [a; 4];
        for (k, row) in rows.iter_mut().enumerate() {
            *row = a.wrapping_add(3 * k * inputs);
        }
        let mut b = b;
        for _ in 0..inputs {
            let mut bv = [S::splat(0.0); V];
            for (v, x) in bv.iter_mut().enumerate() {
                *x = S::load(b.add(v * S::LANES));
            }
            for p in 0..P {
                let x = S::splat(*rows[p / 3].wrapping_add(p % 3 * inputs));
                for v in 0..V {
                    acc[p][v] = S::fma(x, bv[v], acc[p][v]);
                }
            }
            for row in &mut rows {
                *row = row.wrapping_add(1);
            }
            b = b.add(width);
        }
        for (p, row) in acc.iter().enumerate() {
            for (v, x) in row.iter().enumerate() {
                S::store(c.add(p * width + v * S::LANES), *x);
            }
        }
    }
}

/// Transforms the products of a panel back and writes the pixels that lie in the image.
#[inline(always)]
unsafe fn outputs<S: Simd, const V: usize>(work: &Work, panel: usize, sums: &mut [f32]) {
    let Tiles { height, width, .. } = work.tiles;
    let (rows, columns, channels) = (work.tiles.rows(), work.tiles.columns(), work.weights.channels);
    // SAFETY: `y` and `x` are checked against the image; vectors end with the output's channels.
    unsafe {
        for v in 0..V {
            let channel = panel * work.weights.width + v * S::LANES;
            let lanes = (channels - channel).min(S::LANES);
            // The product of the first tile's first pixel.
            let first = products::<S>(work, 0, v);
            let mut total = Sums::<S>::around(transform::tile::<S>(first)[0][0]);
            for (k, unit) in work.units.clone().enumerate() {
                let offset = unit / rows * height * width * channels;
                let out = work.out.at(offset);
                for column in 0..columns {
                    let m = products::<S>(work, k * columns + column, v);
                    for (dy, line) in transform::tile::<S>(m).into_iter().enumerate() {
                        for (dx, value) in line.into_iter().enumerate() {
                            let (y, x) = (2 * (unit % rows) + dy, 2 * column + dx);
                            if y < height && x < width {
                                if let Finish::Statistics = work.finish {
                                    total.add(value);
                                }
                                finish_vector::<S>(work.finish, value, out, offset, (y * width + x) * channels, channel, lanes);
                            }
                        }
                    }
                }
            }
            if let Finish::Statistics = work.finish {
                total.store(sums, channel);
            }
        }
    }
}

/// The sixteen products of a tile.
#[inline(always)]
unsafe fn products<S: Simd>(work: &Work, tile: usize, v: usize) -> [[S::V; 4]; 4] {
    // SAFETY: as in `outputs`.
    unsafe {
        let from = work.products.at(tile * work.weights.width + v * S::LANES);
        let mut m = [[S::splat(0.0); 4]; 4];
        for (p, m) in m.as_flattened_mut().iter_mut().enumerate() {
            *m = S::load(from.add(p * work.product_pitch));
        }
        m
    }
}
