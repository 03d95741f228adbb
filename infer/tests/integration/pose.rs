//! Poses of drawn markers, and of everything that is none.
use crate::scene::{self, Style};
use tcross_dataset::{PoseOutcome, Rng};
use tcross_infer::pose::{self, Config};

#[test]
fn clean_markers_are_found_to_a_fraction_of_a_pixel() {
    let style = Style { width_px: (60.0, 160.0), tilt_deg: (0.0, 45.0), blur: (0.0, 0.01), wobble: 0.0, noise: 1.0, ..Style::default() };
    let mut found = 0;
    for index in 0..20 {
        let mut rng = Rng::for_item(2, "test/pose", index);
        let mut image = scene::clutter(320, 240, &mut rng);
        let drawn = scene::draw(&mut image, &style, &mut rng);
        if let PoseOutcome::Found(pose) = pose::recover(&image, &drawn.bounds, &Config::default()) {
            let off = |k: usize| (pose.corners.0[k][0] - drawn.corners.0[k][0]).hypot(pose.corners.0[k][1] - drawn.corners.0[k][1]);
            found += usize::from((0..4).all(|k| off(k) < 1.0));
        }
    }
    assert!(found >= 14, "{found} of 20");
}
