//! Erosion and dilation of a picture of yes and no by a square.

/// A yes or no for every cell.
pub struct Mask {
    /// Cells a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub cells: Vec<bool>,
}

/// Sliding maximum (or minimum) over `2 * radius + 1` cells along one axis, cells outside counting as unmarked.
fn slide(cells: &mut [bool], lines: usize, length: usize, line_step: usize, step: usize, radius: usize, grow: bool) {
    let mut line = vec![false; length];
    for l in 0..lines {
        for (k, v) in line.iter_mut().enumerate() {
            *v = cells[l * line_step + k * step];
        }
        // Distance since the last cell that decides (marked when growing, unmarked when shrinking), forwards then backwards.
        for reverse in [false, true] {
            let mut since = if grow { radius + 1 } else { 0 };
            for k in 0..length {
                let k = if reverse { length - 1 - k } else { k };
                since = if line[k] == grow { 0 } else { since + 1 };
                if since <= radius {
                    cells[l * line_step + k * step] = grow;
                }
                if !grow && !reverse && k < radius {
                    cells[l * line_step + k * step] = false;
                }
                if !grow && reverse && k + radius >= length {
                    cells[l * line_step + k * step] = false;
                }
            }
        }
    }
}

/// Grows (dilates) or shrinks (erodes) a mask by a square of `2 * radius + 1` cells.
pub(super) fn morph(mask: &mut Mask, radius: usize, grow: bool) {
    let (w, h) = (mask.width, mask.height);
    slide(&mut mask.cells, h, w, w, 1, radius, grow);
    slide(&mut mask.cells, w, h, 1, w, radius, grow);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn naive_morph(mask: &Mask, radius: i64, grow: bool) -> Vec<bool> {
        let at = |x: i64, y: i64| {
            x >= 0 && y >= 0 && x < mask.width as i64 && y < mask.height as i64 && mask.cells[y as usize * mask.width + x as usize]
        };
        let mut out = Vec::new();
        for y in 0..mask.height as i64 {
            for x in 0..mask.width as i64 {
                let mut near = (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy)));
                out.push(if grow { near.any(|(dx, dy)| at(x + dx, y + dy)) } else { near.all(|(dx, dy)| at(x + dx, y + dy)) });
            }
        }
        out
    }

    #[test]
    fn growing_and_shrinking_equal_looking_at_every_neighbour() {
        let mut rng = tcross_dataset::Rng::for_item(3, "test/morph", 0);
        for (w, h) in [(1, 1), (2, 7), (13, 9), (20, 20)] {
            for radius in 0..4 {
                for grow in [false, true] {
                    let p = if grow { 0.1 } else { 0.9 };
                    let mut mask = Mask { width: w, height: h, cells: (0..w * h).map(|_| rng.chance(p)).collect() };
                    let naive = naive_morph(&mask, radius as i64, grow);
                    morph(&mut mask, radius, grow);
                    assert_eq!(mask.cells, naive, "{w}x{h} radius {radius} grow {grow}");
                }
            }
        }
    }
}
