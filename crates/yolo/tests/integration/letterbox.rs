//! The letterbox is Darknet's, to the bit.
use crate::golden;
use tcross_yolo::{NetSize, input};

#[test]
fn pictures_of_every_proportion() {
    let Some(dir) = golden::folder("darknet-tiny") else { return };
    let dir = dir.join("letterbox");
    for case in golden::json(dir.join("cases.json")).as_array().unwrap() {
        let number = |key: &str| case[key].as_u64().unwrap() as usize;
        let net = NetSize { width: number("net_width"), height: number("net_height") };
        check(&dir.join(case["image"].as_str().unwrap()), net, &dir.join(case["output"].as_str().unwrap()));
    }
}

#[test]
fn a_photo() {
    let Some(dir) = golden::folder("darknet-tiny") else { return };
    check(&dir.join("dog-decoded.png"), NetSize::square(416), &dir.join("dog-input.npy"));
}

fn check(image: &std::path::Path, net: NetSize, expected: &std::path::Path) {
    let image = image::open(image).unwrap().to_rgb8();
    let mut out = vec![f32::NAN; 3 * net.width * net.height];
    input::prepare(&image, net, &mut out);
    assert_eq!(golden::max_difference(&out, &golden::npy(expected).1), 0.0, "{}", expected.display());
}
