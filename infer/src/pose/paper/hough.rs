//! Edges and lines: Canny without its blur, and the progressive probabilistic Hough transform.
use crate::pose::plane::Point;
use tcross_dataset::Rng;

/// A picture of one channel, row by row.
#[derive(Debug, Clone)]
pub struct Grey {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 0..255.
    pub pixels: Vec<u8>,
}

/// Canny's edges with a 3x3 Sobel and the gradient's absolute sum: thinned across the gradient, kept from `high` on and
/// wherever they hang together with such a pixel at `low` or more.
#[must_use]
pub fn canny(grey: &Grey, low: i32, high: i32) -> Vec<bool> {
    let (w, h) = (grey.width, grey.height);
    let at = |x: usize, y: usize| i32::from(grey.pixels[y * w + x]);
    let (mut gx, mut gy, mut strength) = (vec![0; w * h], vec![0; w * h], vec![0; w * h]);
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            let column = |c: usize| at(c, y - 1) + 2 * at(c, y) + at(c, y + 1);
            let row = |r: usize| at(x - 1, r) + 2 * at(x, r) + at(x + 1, r);
            gx[i] = column(x + 1) - column(x - 1);
            gy[i] = row(y + 1) - row(y - 1);
            strength[i] = gx[i].abs() + gy[i].abs();
        }
    }
    let mut edges = vec![false; w * h];
    let mut thin = vec![false; w * h];
    let mut stack = Vec::new();
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            if strength[i] < low {
                continue;
            }
            // Neighbours across the edge: in the nearest of four directions (tangents of 22.5 and 67.5 degrees).
            let (ax, ay) = (f64::from(gx[i].abs()), f64::from(gy[i].abs()));
            let step = if ay < 0.414_2 * ax {
                1
            } else if ay > 2.414_2 * ax {
                w
            } else if (gx[i] > 0) == (gy[i] > 0) {
                w + 1
            } else {
                w - 1
            };
            if strength[i] > strength[i - step] && strength[i] >= strength[i + step] {
                thin[i] = true;
                if strength[i] >= high {
                    edges[i] = true;
                    stack.push(i);
                }
            }
        }
    }
    while let Some(i) = stack.pop() {
        for j in [i - w - 1, i - w, i - w + 1, i - 1, i + 1, i + w - 1, i + w, i + w + 1] {
            if thin[j] && !edges[j] {
                edges[j] = true;
                stack.push(j);
            }
        }
    }
    edges
}

/// How segments are looked for.
#[derive(Debug, Clone, Copy)]
pub struct Search {
    /// Votes from which a line is followed.
    pub threshold: i32,
    /// Least extent of a segment along either axis, px.
    pub min_length: f64,
    /// Largest gap inside a segment, px.
    pub max_gap: usize,
    /// The search ends with so many segments.
    pub enough: usize,
}

const ANGLES: usize = 180;

/// The votes of edge pixels for lines at every degree and pixel of distance.
struct Votes {
    counts: Vec<i16>,
    cosines: [f32; ANGLES],
    sines: [f32; ANGLES],
    /// Distances an angle: from `-nearest` on.
    distances: usize,
    nearest: f32,
}

impl Votes {
    fn new(w: usize, h: usize) -> Self {
        // x cos + y sin lies between -w and the diagonal, which is shorter than w + h.
        let distances = 2 * w + h + 2;
        let turn = |n: usize| (n as f32).to_radians();
        Self {
            counts: vec![0; ANGLES * distances],
            cosines: std::array::from_fn(|n| turn(n).cos()),
            sines: std::array::from_fn(|n| turn(n).sin()),
            distances,
            nearest: w as f32 + 0.5,
        }
    }

    /// Adds `by` for every line through a pixel; the index of the angle with most votes afterwards, and those votes.
    fn add(&mut self, x: usize, y: usize, by: i16) -> (usize, i32) {
        let (x, y) = (x as f32, y as f32);
        // All distances first: many at once.
        let rows: [i32; ANGLES] = std::array::from_fn(|n| (x * self.cosines[n] + y * self.sines[n] + self.nearest) as i32);
        let mut best = (0, i16::MIN);
        for ((n, counts), r) in self.counts.chunks_exact_mut(self.distances).enumerate().zip(rows) {
            let count = &mut counts[r as usize];
            *count += by;
            if *count > best.1 {
                best = (n, *count);
            }
        }
        (best.0, i32::from(best.1))
    }
}

/// Segments among edge pixels (Matas, Galambos and Kittler, 2000): pixels vote in random order; as soon as a line has enough
/// votes it is followed both ways over gaps, and its pixels are taken out.
#[must_use]
pub fn segments(edges: &[bool], width: usize, height: usize, search: Search, rng: &mut Rng) -> Vec<[Point; 2]> {
    let mut left = edges.to_vec();
    let mut order: Vec<usize> = (0..edges.len()).filter(|i| edges[*i]).collect();
    rng.shuffle(&mut order);
    let mut votes = Votes::new(width, height);
    let mut found = Vec::new();
    for i in order {
        if !left[i] {
            continue;
        }
        let (x, y) = (i % width, i / width);
        let (angle, count) = votes.add(x, y, 1);
        if count < search.threshold {
            continue;
        }
        let (c, s) = (votes.cosines[angle], votes.sines[angle]);
        // Along the line, one pixel at a time on its longer axis.
        let scale = c.abs().max(s.abs());
        let step = [f64::from(-s / scale), f64::from(c / scale)];
        let walk = |sign: f64, visit: &mut dyn FnMut(usize, f64) -> bool| {
            for k in 0.. {
                let (px, py) = ((x as f64 + sign * k as f64 * step[0]).round(), (y as f64 + sign * k as f64 * step[1]).round());
                let inside = px >= 0.0 && py >= 0.0 && px < width as f64 && py < height as f64;
                if !inside || !visit(py as usize * width + px as usize, f64::from(k)) {
                    break;
                }
            }
        };
        let mut ends = [0.0; 2];
        for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
            let mut gap = 0;
            walk(sign, &mut |j, k| {
                if left[j] {
                    (gap, *end) = (0, k);
                } else {
                    gap += 1;
                }
                gap <= search.max_gap
            });
        }
        let long = ends[0] + ends[1] >= search.min_length;
        for (end, sign) in ends.iter().zip([1.0, -1.0]) {
            walk(sign, &mut |j, k| {
                if left[j] {
                    if long {
                        votes.add(j % width, j / width, -1);
                    }
                    left[j] = false;
                }
                k < *end
            });
        }
        if long {
            let point = |t: f64| [x as f64 + 0.5 + t * step[0], y as f64 + 0.5 + t * step[1]];
            found.push([point(ends[0]), point(-ends[1])]);
            if found.len() >= search.enough {
                break;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::plane::{Line, distance};

    #[test]
    fn a_square_has_four_sides() {
        let (w, h) = (80, 70);
        let inside = |i: usize| (15..60).contains(&(i % w)) && (12..55).contains(&(i / w));
        let grey = Grey { width: w, height: h, pixels: (0..w * h).map(|i| if inside(i) { 255 } else { 0 }).collect() };
        let edges = canny(&grey, 50, 200);
        let count = edges.iter().filter(|e| **e).count();
        assert!((150..200).contains(&count), "{count}");
        let search = Search { threshold: 20, min_length: 15.0, max_gap: 5, enough: usize::MAX };
        let found = segments(&edges, w, h, search, &mut Rng::for_item(0, "test/hough", 0));
        for (point, side) in [([37.0, 12.0], "top"), ([60.0, 33.0], "right"), ([37.0, 55.0], "bottom"), ([15.0, 33.0], "left")] {
            let near = |s: &&[Point; 2]| distance(s[0], s[1]) > 35.0 && Line::through(s[0], s[1]).unwrap().distance(point).abs() < 1.6;
            assert!(found.iter().any(|s| near(&s)), "no {side} among {found:?}");
        }
    }
}
