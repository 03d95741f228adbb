use std::{collections::BTreeSet, fs, path::Path, sync::atomic::AtomicBool};
use tcross_datagen::{Backgrounds, Config, DatagenError, Dist, GenerateOptions, Style, generate};
use tcross_dataset::{Dataset, Split};

fn photo(dir: &Path, name: &str, shade: u8) {
    let image = image::RgbImage::from_fn(150, 120, |x, y| image::Rgb([shade, (x + y) as u8, (x * 3) as u8]));
    image.save(dir.join(name)).unwrap();
}

fn config() -> Config {
    let mut config =
        Config { style: Style::Paper, images: 40, width: 96, height: 96, jpeg_quality: Dist::constant(95.0), ..Default::default() };
    config.background.mirrored = 0.0;
    config
}

#[test]
fn a_photo_stands_in_one_split_only_and_bad_ones_are_named() {
    let photos = tempfile::tempdir().unwrap();
    fs::create_dir(photos.path().join("deep")).unwrap();
    for k in 0..12 {
        photo(photos.path(), &format!("deep/{k:02}.jpg"), k * 20);
    }
    photo(photos.path(), "alpha.png", 3);
    photo(photos.path(), "lossless.webp", 9);
    fs::write(photos.path().join("empty.jpg"), b"").unwrap();
    fs::write(photos.path().join("notes.txt"), b"not a photo").unwrap();
    let half = fs::read(photos.path().join("deep/03.jpg")).unwrap();
    fs::write(photos.path().join("cut.png"), &fs::read(photos.path().join("alpha.png")).unwrap()[..300]).unwrap();
    fs::write(photos.path().join("deep/03.jpg"), half).unwrap();
    let out = tempfile::tempdir().unwrap();
    let backgrounds = Backgrounds::open(photos.path()).unwrap();
    let options = GenerateOptions { out: out.path().to_owned(), seed: 1, ..Default::default() };
    let made = generate(&config(), &backgrounds, &options, &AtomicBool::new(false), &mut |_| {}).unwrap();
    assert_eq!(made.manifest.backgrounds.skipped, ["cut.png", "empty.jpg"]);
    let dataset = Dataset::open(out.path()).unwrap();
    let used = Split::ALL.map(|s| dataset.records(s).unwrap().into_iter().filter_map(|r| r.background).collect::<BTreeSet<_>>());
    assert!(used.iter().all(|names| !names.is_empty()));
    assert!(used[0].is_disjoint(&used[1]) && used[0].is_disjoint(&used[2]) && used[1].is_disjoint(&used[2]));
    assert!(used.iter().flatten().any(|n| n.starts_with("deep/")));
}

#[test]
fn no_photo_is_an_error_that_says_where() {
    let photos = tempfile::tempdir().unwrap();
    let error = Backgrounds::open(photos.path()).unwrap_err();
    assert!(matches!(&error, DatagenError::NoPhotos { found: 0, .. }));
    assert!(error.to_string().contains(&photos.path().display().to_string()));
    assert!(Backgrounds::open(photos.path().join("missing")).is_err());
}

/// A JPEG whose EXIF block says that it is to be turned by 90 degrees: an APP1 segment with one entry, put after the first marker.
fn turned(jpeg: &[u8]) -> Vec<u8> {
    let exif: &[u8] = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
    let mut out = jpeg[..2].to_vec();
    out.extend([0xff, 0xe1, 0, exif.len() as u8 + 2]);
    out.extend(exif);
    out.extend(&jpeg[2..]);
    out
}

#[test]
fn photos_are_turned_as_their_exif_says() {
    let photos = tempfile::tempdir().unwrap();
    // Left half dark, right half bright; turned clockwise the upper half is dark.
    let image = image::RgbImage::from_fn(128, 128, |x, _| image::Rgb([if x < 64 { 10 } else { 240 }; 3]));
    for k in 0..3 {
        let path = photos.path().join(format!("{k}.jpg"));
        image.save(&path).unwrap();
        let bytes = turned(&fs::read(&path).unwrap());
        fs::write(path, bytes).unwrap();
    }
    let backgrounds = Backgrounds::open(photos.path()).unwrap();
    let mut config = config();
    config.background.crop = Dist::constant(1.0);
    let image = backgrounds.backdrop(&config, 0, 0).unwrap().into_image();
    let at = |x: u32, y: u32| image.get_pixel(x, y)[0];
    assert!(at(10, 10) < 40 && at(85, 10) < 40 && at(10, 85) > 200 && at(85, 85) > 200);
}
