//! Augmentation: first all chance is drawn into a [`Plan`], then the plan moves pixels and labels together.
pub mod color;
pub mod placement;
pub mod planes;

use crate::config::{Augment, Sampling};
use color::Color;
use placement::{Kernel, Placement};
use planes::Planes;
use std::sync::Arc;
use tcross_dataset::{PixelBox, Rng, geom::boxes::iou};
use tcross_yolo::{NetSize, Truth};

/// A box of an image, in pixels of its letterboxed form.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// Continuous pixels.
    pub bounds: PixelBox,
    /// Index of the class.
    pub class: u32,
    /// The marker's points: its centre, then its corners clockwise as seen, the stem's first; none where they are not known.
    pub points: Option<[[f64; 2]; 5]>,
}

/// What images a plan may draw on: their labels, all of one letterboxed size.
pub trait Labels {
    /// Number of images.
    fn count(&self) -> usize;
    /// Of image `index`.
    fn labels(&self, index: usize) -> &[Label];
    /// Size of every image in pixels.
    fn size(&self) -> NetSize;
}

/// One image's place in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// Index of the image.
    pub image: usize,
    /// From the image to the network's input.
    pub placement: Placement,
    /// The part of the input it may cover.
    pub window: PixelBox,
}

/// One image, or four as a mosaic, with their common colours.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Where the images lie.
    pub tiles: Vec<Tile>,
    /// What is done to the colours.
    pub color: Color,
    /// How pixels are sampled.
    pub kernel: Kernel,
    /// Share in the mix: 1 for a plain picture.
    pub weight: f32,
}

/// How much of an image is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum View {
    /// All of it, brought to the input's size.
    Whole,
    /// A part as large as the input, at the image's own scale; around a marker with this probability.
    Window {
        /// 0..=1.
        focus: f64,
    },
}

/// What the network is to be shown at a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Input {
    /// Size in pixels.
    pub net: NetSize,
    /// How much of each image.
    pub view: View,
    /// Share of the training that lies before, 0..=1.
    pub fraction: f64,
}

/// Everything about one input of the network, before a pixel is touched.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// One, or two that are mixed.
    pub pictures: Vec<Picture>,
    /// Size of the network's input.
    pub net: NetSize,
}

/// A label survives where its centre stays inside and at least this share of its area.
const LEAST_VISIBLE: f64 = 0.3;
/// And where no side is shorter than this many pixels.
const LEAST_SIDE_PX: f64 = 2.0;
/// A marker that a window is laid around covers at most this share of the window's side.
const MOST_OF_WINDOW: f64 = 0.9;

impl Plan {
    /// An image as it is, brought to the network's size.
    #[must_use]
    pub fn plain(image: usize, size: NetSize, net: NetSize) -> Self {
        let tile = Tile { image, placement: Placement::rectangle(&whole(size), &whole(net)), window: whole(net) };
        Self { pictures: vec![Picture { tiles: vec![tile], color: Color::NONE, kernel: Kernel::Smooth, weight: 1.0 }], net }
    }

    /// Draws what happens to `image` when `fraction` (0..=1) of the training is over. Mosaics are made of whole images only.
    #[must_use]
    pub fn sample(config: &Augment, set: &dyn Labels, image: usize, input: Input, rng: &mut Rng) -> Self {
        let Input { net, view, fraction } = input;
        let mut draw = Draw { config, set, net, view, rng };
        let mosaic = view == View::Whole && fraction < config.mosaic_until;
        let mut pictures = vec![draw.picture(image, mosaic)];
        if draw.rng.chance(config.mixup) {
            let partner = draw.rng.index(set.count());
            let share = beta_three_halves(draw.rng) as f32;
            pictures.push(draw.picture(partner, mosaic));
            pictures[0].weight = share;
            pictures[1].weight = 1.0 - share;
        }
        Self { pictures, net }
    }

    /// Writes the input, `[3, height, width]` 0..1, and returns what is to be learned from it. An image that `read` does not give
    /// leaves grey and no labels.
    pub fn render(&self, set: &dyn Labels, read: &mut dyn FnMut(usize) -> Option<Arc<Planes>>, out: &mut [f32]) -> Vec<Truth> {
        let mut truths = Vec::new();
        for (k, picture) in self.pictures.iter().enumerate() {
            let mut canvas = None;
            for tile in &picture.tiles {
                let Some(image) = read(tile.image) else { continue };
                let untouched = tile.placement == Placement::IDENTITY && tile.window == whole(self.net);
                if untouched && (image.width, image.height) == (self.net.width, self.net.height) {
                    canvas = Some(image);
                } else {
                    let canvas = canvas.get_or_insert_with(|| Arc::new(Planes::grey(self.net.width, self.net.height)));
                    tile.placement.draw(&image, &tile.window, picture.kernel, Arc::make_mut(canvas));
                }
                let seen = set.labels(tile.image).iter().filter_map(|label| self.truth(tile, label));
                truths.extend(seen.map(|truth| Truth { weight: picture.weight, ..truth }));
            }
            let canvas = canvas.unwrap_or_else(|| Arc::new(Planes::grey(self.net.width, self.net.height)));
            picture.color.write(&canvas, picture.weight, k > 0, out);
        }
        truths
    }

    fn truth(&self, tile: &Tile, label: &Label) -> Option<Truth> {
        let moved = tile.placement.bounds(&label.bounds);
        let (center, w) = (moved.center(), &tile.window);
        let kept = PixelBox {
            x_min: moved.x_min.max(w.x_min),
            y_min: moved.y_min.max(w.y_min),
            x_max: moved.x_max.min(w.x_max),
            y_max: moved.y_max.min(w.y_max),
        };
        let inside = (w.x_min..=w.x_max).contains(&center[0]) && (w.y_min..=w.y_max).contains(&center[1]);
        let large = kept.area() >= LEAST_VISIBLE * moved.area() && kept.short_side() >= LEAST_SIDE_PX;
        let keypoints = || label.points.iter().flat_map(|points| self.points(tile, points)).collect();
        (inside && large).then(|| Truth { keypoints: keypoints(), ..Truth::from_net_box(&kept, label.class, self.net) })
    }

    /// A marker's points in fractions of the input, the corners clockwise as seen in the mirror too.
    fn points(&self, tile: &Tile, points: &[[f64; 2]; 5]) -> [[f32; 2]; 5] {
        let [sx, sy] = tile.placement.scale;
        let order = if sx * sy < 0.0 { [0, 1, 4, 3, 2] } else { [0, 1, 2, 3, 4] };
        order.map(|k| {
            let [x, y] = tile.placement.point(points[k]);
            [(x / self.net.width as f64) as f32, (y / self.net.height as f64) as f32]
        })
    }
}

fn whole(size: NetSize) -> PixelBox {
    PixelBox::from([0.0, 0.0, size.width as f64, size.height as f64])
}

/// Beta(1.5, 1.5), whose density is that of sqrt(x (1 - x)), by rejection.
fn beta_three_halves(rng: &mut Rng) -> f64 {
    loop {
        let x = rng.unit();
        if 0.5 * rng.unit() <= (x * (1.0 - x)).sqrt() {
            return x;
        }
    }
}

/// One draw's surroundings.
struct Draw<'a> {
    config: &'a Augment,
    set: &'a dyn Labels,
    net: NetSize,
    view: View,
    rng: &'a mut Rng,
}

impl Draw<'_> {
    fn picture(&mut self, image: usize, mosaic: bool) -> Picture {
        let tiles = if mosaic && self.rng.chance(self.config.mosaic) { self.mosaic(image) } else { vec![self.tile(image)] };
        Picture { tiles, color: Color::sample(self.config, self.rng), kernel: self.kernel(), weight: 1.0 }
    }

    fn kernel(&mut self) -> Kernel {
        match self.config.sampling {
            Sampling::Smooth => Kernel::Smooth,
            Sampling::Bilinear => Kernel::Bilinear,
            Sampling::Nearest => Kernel::Nearest,
            Sampling::Random => *self.rng.choose(&[Kernel::Smooth, Kernel::Bilinear, Kernel::Nearest]),
        }
    }

    /// An image, or a part of it, over the whole input.
    fn tile(&mut self, image: usize) -> Tile {
        let mut placement = match self.view {
            View::Whole => Placement::rectangle(&whole(self.set.size()), &whole(self.net)),
            View::Window { focus } => self.part(image, focus),
        };
        if self.rng.chance(self.config.expand) {
            placement = placement.then(self.expand());
        }
        if self.rng.chance(self.config.crop) {
            placement = placement.then(self.crop(image, placement));
        }
        placement = placement.then(self.jitter());
        if self.rng.chance(self.config.flip) {
            placement = placement.then(Placement::flip(self.net.width));
        }
        Tile { image, placement, window: whole(self.net) }
    }

    /// A window of the input's size onto the image: around a marker with probability `focus`, anywhere else.
    fn part(&mut self, image: usize, focus: f64) -> Placement {
        let labels = self.set.labels(image);
        let marker = (self.rng.chance(focus) && !labels.is_empty()).then(|| labels[self.rng.index(labels.len())].bounds);
        let (size, net) = (self.set.size(), self.net);
        let most = MOST_OF_WINDOW * net.width.min(net.height) as f64;
        let scale = match marker.map(|m| m.width().max(m.height())) {
            Some(side) if side > most => most / side * self.rng.uniform(0.5, 1.0),
            _ => 1.0,
        };
        // Along each axis, `low..=high` are the positions of the window's first pixel at which it lies in the image and holds the marker.
        let mut shift = |length: usize, window: usize, marker: Option<[f64; 2]>| {
            let (window, slack) = (window as f64, scale * length as f64 - window as f64);
            let (mut low, mut high) = (slack.min(0.0), slack.max(0.0));
            if let Some([first, last]) = marker {
                low = low.max(scale * last - window).min(high);
                high = high.min(scale * first).max(low);
            }
            -self.rng.uniform(low, high).round()
        };
        let shift = [
            shift(size.width, net.width, marker.map(|m| [m.x_min, m.x_max])),
            shift(size.height, net.height, marker.map(|m| [m.y_min, m.y_max])),
        ];
        Placement { scale: [scale; 2], shift }
    }

    /// The input becomes a part of a larger canvas, which is brought back to the input's size.
    fn expand(&mut self) -> Placement {
        let scale = 1.0 / self.rng.uniform(1.0, self.config.expand_most);
        let shift = [self.net.width, self.net.height].map(|side| side as f64 * self.rng.uniform(0.0, 1.0 - scale));
        Placement { scale: [scale; 2], shift }
    }

    /// A crop that keeps a marker's centre and has a drawn least IoU with every marker, as SSD does it; with small markers most
    /// constraints cannot be met, and the image stays whole.
    fn crop(&mut self, image: usize, so_far: Placement) -> Placement {
        let least = *self.rng.choose(&[f64::NEG_INFINITY, 0.1, 0.3, 0.5, 0.7, 0.9]);
        let boxes: Vec<PixelBox> = self.set.labels(image).iter().map(|label| so_far.bounds(&label.bounds)).collect();
        let (width, height) = (self.net.width as f64, self.net.height as f64);
        for _ in 0..50 {
            let scale = self.rng.uniform(0.3, 1.0);
            let aspect = self.rng.log_uniform((scale * scale).max(0.5), (1.0 / (scale * scale)).min(2.0)).sqrt();
            let (w, h) = (width * (scale * aspect).min(1.0), height * (scale / aspect).min(1.0));
            let (x, y) = (self.rng.uniform(0.0, width - w), self.rng.uniform(0.0, height - h));
            let crop = PixelBox::from([x, y, x + w, y + h]);
            let holds =
                |b: &PixelBox| (crop.x_min..crop.x_max).contains(&b.center()[0]) && (crop.y_min..crop.y_max).contains(&b.center()[1]);
            if boxes.is_empty() || (boxes.iter().all(|b| iou(b, &crop) >= least) && boxes.iter().any(holds)) {
                return Placement::rectangle(&crop, &whole(self.net));
            }
        }
        Placement::IDENTITY
    }

    /// Size, aspect and position, about the middle of the input.
    fn jitter(&mut self) -> Placement {
        let mut factor = |range: f64| if range > 0.0 { self.rng.log_uniform(1.0 / (1.0 + range), 1.0 + range) } else { 1.0 };
        let (size, aspect) = (factor(self.config.scale), factor(self.config.aspect).sqrt());
        let scale = [size * aspect, size / aspect];
        let side = [self.net.width as f64, self.net.height as f64];
        let t = self.config.translate;
        let mut moved = || if t > 0.0 { self.rng.uniform(-t, t) } else { 0.0 };
        let by = [moved(), moved()];
        let shift = [0, 1].map(|k| side[k] * (0.5 * (1.0 - scale[k]) + by[k]));
        Placement { scale, shift }
    }

    /// Four images around a point near the middle, each scaled by 0.5 to 1 and moved so that it fills its quarter.
    fn mosaic(&mut self, image: usize) -> Vec<Tile> {
        let [w, h] = [self.net.width as f64, self.net.height as f64];
        let at = [w, h].map(|side| (side * self.rng.uniform(0.3, 0.7)).round());
        let quarters = [[0.0, 0.0, at[0], at[1]], [at[0], 0.0, w, at[1]], [0.0, at[1], at[0], h], [at[0], at[1], w, h]];
        let own = self.rng.index(4);
        let mut tile = |(k, quarter): (usize, [f64; 4])| {
            let image = if k == own { image } else { self.rng.index(self.set.count()) };
            let window = PixelBox::from(quarter);
            let least = (window.width() / w).max(window.height() / h).max(0.5);
            let scale = self.rng.log_uniform(least, 1.0);
            let mut place = |low: f64, high: f64, side: f64| self.rng.uniform(high - scale * side, low);
            let shift = [place(window.x_min, window.x_max, w), place(window.y_min, window.y_max, h)];
            let mut placement = Placement::rectangle(&whole(self.set.size()), &whole(self.net));
            if self.rng.chance(self.config.flip) {
                placement = placement.then(Placement::flip(self.net.width));
            }
            Tile { image, placement: placement.then(Placement { scale: [scale; 2], shift }), window }
        };
        quarters.into_iter().enumerate().map(&mut tile).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images of one colour with a white rectangle where the label says.
    struct Toy {
        labels: Vec<Vec<Label>>,
    }

    impl Toy {
        fn new(count: usize) -> Self {
            let mut rng = Rng::for_item(1, "test/toy", 0);
            let mut label = || {
                let (x, y, w, h) = (rng.int(4, 40), rng.int(4, 40), rng.int(8, 20), rng.int(8, 20));
                Label { bounds: PixelBox::from([x, y, x + w, y + h].map(|v| v as f64)), class: 0, points: None }
            };
            Self { labels: (0..count).map(|_| vec![label()]).collect() }
        }

        fn image(&self, index: usize) -> Arc<Planes> {
            let mut image = Planes { width: 64, height: 64, data: vec![20; 3 * 4096] };
            for label in &self.labels[index] {
                let b = label.bounds;
                for channel in 0..3 {
                    (b.y_min as usize..b.y_max as usize)
                        .for_each(|y| image.row_mut(channel, y)[b.x_min as usize..b.x_max as usize].fill(250));
                }
            }
            Arc::new(image)
        }
    }

    impl Labels for Toy {
        fn count(&self) -> usize {
            self.labels.len()
        }
        fn labels(&self, index: usize) -> &[Label] {
            &self.labels[index]
        }
        fn size(&self) -> NetSize {
            NetSize::square(64)
        }
    }

    fn everything() -> Augment {
        Augment {
            gain: 0.05,
            shift: 0.0,
            scale: 0.4,
            translate: 0.2,
            aspect: 0.2,
            mosaic: 0.3,
            expand: 0.3,
            crop: 0.5,
            sampling: Sampling::Random,
            ..Augment::default()
        }
    }

    fn early(side: usize) -> Input {
        Input { net: NetSize::square(side), view: View::Whole, fraction: 0.1 }
    }

    /// A window shows its marker whole and as large as it is, or scaled down where it does not fit, with its label around its pixels.
    #[test]
    fn windows_hold_their_marker() {
        let set = Toy::new(12);
        let config = Augment { flip: 0.0, gain: 0.0, shift: 0.0, ..Augment::default() };
        let (mut places, mut scaled) = (std::collections::BTreeSet::new(), 0);
        for position in 0..240_u64 {
            let side = if position % 2 == 0 { 32 } else { 16 };
            let input = Input { net: NetSize::square(side), view: View::Window { focus: 1.0 }, fraction: 0.0 };
            let image = (position % 12) as usize;
            let mut rng = Rng::for_item(3, "test/windows", position);
            let plan = Plan::sample(&config, &set, image, input, &mut rng);
            let mut out = vec![0.0; 3 * side * side];
            let truths = plan.render(&set, &mut |i| Some(set.image(i)), &mut out);
            let (seen, own) = (&truths[0].bounds, &set.labels[image][0].bounds);
            let fits = own.width().max(own.height()) <= 0.9 * side as f64;
            let expected = [own.width(), own.height()].map(|length| length as f32 / side as f32);
            assert_eq!(fits, [seen.w, seen.h] == expected, "{seen:?} of {own:?}");
            assert!(seen.w <= 0.91 && seen.h <= 0.91 && truths.len() == 1, "{seen:?}");
            let white = out[..side * side].iter().filter(|v| **v > 0.9).count() as f32;
            let area = seen.w * seen.h * (side * side) as f32;
            assert!((white - area).abs() <= if fits { 0.5 } else { 2.5 * (seen.w + seen.h) * side as f32 }, "{white} of {area}");
            scaled += usize::from(!fits);
            places.insert((seen.x * 64.0) as i32);
        }
        assert!(scaled > 20 && places.len() > 20, "{scaled} {places:?}");
    }

    /// Whatever is drawn, each truth lies exactly around white pixels, and there is no white outside the truths that are whole.
    #[test]
    fn labels_move_with_the_pixels() {
        let (set, config) = (Toy::new(12), everything());
        let mut seen = 0;
        for position in 0..300 {
            let mut rng = Rng::for_item(5, "test/augment", position);
            let plan = Plan::sample(&config, &set, (position % 12) as usize, early(96), &mut rng);
            let mut out = vec![0.0; 3 * 96 * 96];
            let truths = plan.render(&set, &mut |i| Some(set.image(i)), &mut out);
            for truth in &truths {
                let b = truth.bounds;
                let (x0, x1) = (96.0 * (b.x - b.w / 2.0), 96.0 * (b.x + b.w / 2.0));
                let (y0, y1) = (96.0 * (b.y - b.h / 2.0), 96.0 * (b.y + b.h / 2.0));
                let inner = |lo: f32, hi: f32| (lo + 1.6).ceil() as usize..((hi - 1.6).floor().max(0.0) as usize).min(96);
                for y in inner(y0, y1) {
                    for x in inner(x0, x1) {
                        assert!(out[y * 96 + x] > 0.8, "position {position}: {plan:?} {truth:?} ({x}, {y}) = {}", out[y * 96 + x]);
                        seen += 1;
                    }
                }
                // Just outside, unless cut by a window: dark.
                let outside = |x: f32, y: f32| {
                    let (x, y) = (x.floor() as isize, y.floor() as isize);
                    ((0..96).contains(&x) && (0..96).contains(&y)).then(|| out[y as usize * 96 + x as usize])
                };
                if plan.pictures[0].tiles.len() == 1 {
                    for v in [outside(x0 - 3.0, (y0 + y1) / 2.0), outside(x1 + 3.0, (y0 + y1) / 2.0), outside((x0 + x1) / 2.0, y1 + 3.0)] {
                        assert!(v.is_none_or(|v| v < 0.7), "position {position}: {v:?}");
                    }
                }
            }
        }
        assert!(seen > 10_000, "{seen}");
    }

    #[test]
    fn the_same_draw_gives_the_same_plan() {
        let set = Toy::new(5);
        let config = Augment { mixup: 0.5, ..everything() };
        let plan = |index| Plan::sample(&config, &set, 2, early(64), &mut Rng::for_item(9, "test/plan", index));
        assert_eq!(plan(3), plan(3));
        assert_ne!(plan(3), plan(4));
    }

    #[test]
    fn mixing_adds_pictures_and_truths_by_weight() {
        let set = Toy::new(2);
        let config = Augment { flip: 0.0, gain: 0.0, shift: 0.0, mixup: 1.0, ..Augment::default() };
        let plan = Plan::sample(&config, &set, 0, early(64), &mut Rng::for_item(1, "test/mix", 0));
        let mut out = vec![0.0; 3 * 4096];
        let truths = plan.render(&set, &mut |i| Some(set.image(i)), &mut out);
        let (a, b) = (plan.pictures[0].weight, plan.pictures[1].weight);
        assert!((a + b - 1.0).abs() < 1e-6);
        assert_eq!(truths.iter().map(|t| t.weight).collect::<Vec<_>>(), [a, b]);
        let (p, q) = (set.image(0), set.image(plan.pictures[1].tiles[0].image));
        for (k, value) in out.iter().enumerate() {
            let want = (a * f32::from(p.data[k]) + b * f32::from(q.data[k])) / 255.0;
            assert!((value - want).abs() < 1e-5);
        }
    }

    #[test]
    fn a_plain_plan_changes_nothing() {
        let set = Toy::new(1);
        let mut out = vec![0.0; 3 * 4096];
        let truths = Plan::plain(0, set.size(), set.size()).render(&set, &mut |i| Some(set.image(i)), &mut out);
        assert_eq!(truths, [Truth::from_net_box(&set.labels[0][0].bounds, 0, set.size())]);
        assert!(out.iter().zip(&set.image(0).data).all(|(a, b)| (a * 255.0 - f32::from(*b)).abs() < 1e-3));
    }

    #[test]
    fn points_move_with_the_pixels_and_stay_clockwise() {
        let mut set = Toy::new(1);
        let b = set.labels[0][0].bounds;
        let corners = [[b.x_max, b.y_min], [b.x_max, b.y_max], [b.x_min, b.y_max], [b.x_min, b.y_min]];
        set.labels[0][0].points = Some([b.center(), corners[0], corners[1], corners[2], corners[3]]);
        let placed = |placement| {
            let tile = Tile { image: 0, placement, window: whole(set.size()) };
            let mut plan = Plan::plain(0, set.size(), set.size());
            plan.pictures[0].tiles = vec![tile];
            plan.render(&set, &mut |i| Some(set.image(i)), &mut vec![0.0; 3 * 4096]).remove(0).keypoints
        };
        let plain = placed(Placement::IDENTITY);
        let near = |a: [f32; 2], b: [f64; 2]| (0..2).all(|k| (f64::from(a[k]) * 64.0 - b[k]).abs() < 1e-4);
        assert!(near(plain[0], b.center()) && (0..4).all(|k| near(plain[k + 1], corners[k])), "{plain:?}");
        // Mirrored, the stem's corner is at the upper left, and the next one clockwise at the upper right.
        let mirrored = placed(Placement::flip(64));
        assert!(near(mirrored[1], [64.0 - b.x_max, b.y_min]) && near(mirrored[2], [64.0 - b.x_min, b.y_min]), "{mirrored:?}");
    }

    #[test]
    fn an_unreadable_image_leaves_grey_and_no_labels() {
        let set = Toy::new(1);
        let mut out = vec![0.0; 3 * 4096];
        let truths = Plan::plain(0, set.size(), set.size()).render(&set, &mut |_| None, &mut out);
        assert!(truths.is_empty() && out.iter().all(|v| (v - 128.0 / 255.0).abs() < 1e-6));
    }

    #[test]
    fn beta_has_the_right_spread() {
        let mut rng = Rng::for_item(1, "test/beta", 0);
        let draws: Vec<f64> = (0..20_000).map(|_| beta_three_halves(&mut rng)).collect();
        let mean = draws.iter().sum::<f64>() / 2e4;
        let variance = draws.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 2e4;
        assert!((mean - 0.5).abs() < 0.01 && (variance - 0.0625).abs() < 0.003, "{mean} {variance}"); // a b / ((a + b)^2 (a + b + 1))
    }
}
