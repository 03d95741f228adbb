//! The distributions of the paper's protocol.
use super::columns::{Column, Law, choice, column, first};
use crate::{
    config::{Config, PaperColors},
    dist::Dist,
    shapes::Shape,
};
use tcross_dataset::{PixelBox, Record};

pub(super) fn columns(config: &Config, records: &[Record]) -> Vec<Column> {
    let p = &config.paper;
    let bounds = |r: &Record| first(r).map(|m| m.bounds);
    // Where a marker may stand depends on its size: its place is judged as a fraction of the room it had.
    let room = |at: f64, size: f64, image: u32| {
        let room = f64::from(image) - size - 1.0;
        (at - 1.0 + 0.5) / room
    };
    let place = || Law::Dist(Dist::uniform(0.0, 1.0));
    let drawn = |name, key, dist: &Dist, of: fn(&PixelBox) -> f64| {
        column(name, key, Law::Whole(dist.clone()), records, move |r| bounds(r).map(|b| of(&b)))
    };
    let other = |key, dist: &Dist, why| column(key, key, Law::Whole(dist.clone()), records, |_| None).absent(why);
    let mut columns = match p.shape {
        Shape::AtSign => vec![
            drawn("side", "paper.at_sign_side", &p.at_sign_side, PixelBox::width),
            other("paper.width", &p.width, "the @ sign has a side of its own"),
            other("paper.height", &p.height, "the @ sign has a side of its own"),
        ],
        _ => vec![
            drawn("width", "paper.width", &p.width, PixelBox::width),
            drawn("height", "paper.height", &p.height, PixelBox::height),
            other("paper.at_sign_side", &p.at_sign_side, "only the @ sign has it"),
        ],
    };
    columns.extend([
        choice("shape", "paper.shape", &[(p.shape.name().to_owned(), 1.0)].into(), records, |r| Some(&first(r)?.shape)),
        column("place_x", "", place(), records, move |r| bounds(r).map(|b| room(b.x_min, b.width(), r.width))),
        column("place_y", "", place(), records, move |r| bounds(r).map(|b| room(b.y_min, b.height(), r.height))),
        column("thickness", "paper.thickness", Law::Whole(p.thickness.clone()), records, |r| first(r)?.thickness),
    ]);
    if p.shape == Shape::TCross {
        columns.push(column("variant", "", Law::Dist(Dist::int(0, 3)), records, |r| {
            let marker = first(r)?;
            let (c, m) = (marker.corners?.0[0], marker.center?);
            Some(f64::from(u8::from(c[0] > m[0])) + 2.0 * f64::from(u8::from(c[1] > m[1])))
        }));
    }
    columns.extend(match p.colors {
        PaperColors::Fixed => fixed(records),
        PaperColors::Colored => colored(records),
    });
    columns
}

/// Green, and blue where there are lines of another colour.
fn fixed(records: &[Record]) -> Vec<Column> {
    let only = |color: &str| [(color.to_owned(), 1.0)].into();
    vec![
        choice("fill", "paper.colors", &only("#00c800"), records, |r| first(r)?.fill.as_deref()),
        choice("line", "paper.colors", &only("#0000c8"), records, |r| first(r)?.line.as_deref()),
    ]
}

/// Which channel of the fill is dark and which of the lines is bright, each alike, and how bright each is.
fn colored(records: &[Record]) -> Vec<Column> {
    let fill = |r: &Record| channels(first(r)?.fill.as_deref()?);
    let line = |r: &Record| channels(first(r)?.line.as_deref()?);
    let number = |k: usize| k as f64;
    let whole = |lo, hi| Law::Dist(Dist::int(lo, hi));
    let (channel, level) = (|| whole(0, 2), || whole(200, 255));
    vec![
        column("fill_dark_channel", "paper.colors", channel(), records, |r| fill(r)?.iter().position(|v| *v == 0).map(number)),
        column("line_channel", "paper.colors", channel(), records, |r| line(r)?.iter().position(|v| *v > 0).map(number)),
        column("fill_level", "paper.colors", level(), records, |r| fill(r)?.into_iter().find(|v| *v > 0).map(f64::from)),
        column("line_level", "paper.colors", level(), records, |r| line(r)?.into_iter().find(|v| *v > 0).map(f64::from)),
    ]
}

/// Red, green and blue of `#rrggbb`.
fn channels(color: &str) -> Option<[u8; 3]> {
    let [_, channels @ ..] = u32::from_str_radix(color.strip_prefix('#')?, 16).ok()?.to_be_bytes();
    Some(channels)
}
