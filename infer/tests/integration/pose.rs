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
            found += 1;
            for k in 0..4 {
                let (a, b) = (pose.corners.0[k], drawn.corners.0[k]);
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1.5, "marker {index}: {:?} {:?}", pose.corners, drawn.corners);
            }
        }
    }
    assert!(found >= 18, "{found} of 20");
}
