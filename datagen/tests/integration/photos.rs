use std::{collections::BTreeSet, fs, path::Path, sync::atomic::AtomicBool};
use tcross_datagen::{Backgrounds, Config, DatagenError, Dist, GenerateOptions, Style, generate};
use tcross_dataset::{Dataset, Rng, Split};

/// Soft blobs: as different from the next picture as photos are.
fn picture(seed: u64) -> image::RgbImage {
    let mut rng = Rng::for_item(seed, "test/photos", 0);
    let blobs: Vec<[f64; 6]> =
        (0..10).map(|_| [rng.unit() * 150.0, rng.unit() * 120.0, rng.uniform(10.0, 40.0), rng.unit(), rng.unit(), rng.unit()]).collect();
    image::RgbImage::from_fn(150, 120, |x, y| {
        let mut sum = [40.0; 3];
        for [bx, by, r, colors @ ..] in &blobs {
            let d2 = (f64::from(x) - bx).powi(2) + (f64::from(y) - by).powi(2);
            (0..3).for_each(|c| sum[c] += 150.0 * colors[c] * (-d2 / (r * r)).exp());
        }
        image::Rgb(sum.map(|v| v.min(255.0) as u8))
    })
}

fn photo(dir: &Path, name: &str, seed: u8) {
    picture(seed.into()).save(dir.join(name)).unwrap();
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

/// A small photo is cut no smaller than the image, so that crops come out larger than they were drawn; the draws are judged.
#[test]
fn crops_of_photos_are_judged_as_drawn() {
    let photos = tempfile::tempdir().unwrap();
    (0..12).for_each(|k| photo(photos.path(), &format!("{k:02}.png"), k * 20));
    let mut config = Config { images: 60, ..config() };
    config.background.mirrored = 0.5;
    let out = tempfile::tempdir().unwrap();
    let options = GenerateOptions { out: out.path().to_owned(), seed: 1, ..Default::default() };
    let backgrounds = Backgrounds::open(photos.path()).unwrap();
    generate(&config, &backgrounds, &options, &AtomicBool::new(false), &mut |_| {}).unwrap();
    let audit = tcross_datagen::audit::audit(out.path()).unwrap();
    for key in ["background.crop", "background.mirrored", "jpeg_quality"] {
        assert!(audit.fits.iter().any(|f| f.key == key && f.count == 60 && f.good), "{key}: {audit:#?}");
    }
    assert!(audit.unjudged.iter().any(|u| u.key == "background.scenes" && u.why == "the backgrounds are photographs"));
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

fn generated(photos: &Path, out: &Path, images: u64) -> tcross_datagen::Manifest {
    let backgrounds = Backgrounds::open(photos).unwrap();
    let options = GenerateOptions { out: out.to_owned(), seed: 1, images: Some(images), ..Default::default() };
    generate(&config(), &backgrounds, &options, &AtomicBool::new(false), &mut |_| {}).unwrap().manifest
}

#[test]
fn photos_of_every_kind_work_or_are_skipped_by_name() {
    let photos = tempfile::tempdir().unwrap();
    let at = |name: &str| photos.path().join(name);
    let plain = image::DynamicImage::ImageRgb8(picture(1));
    plain.to_luma8().save(at("grey.png")).unwrap();
    plain.to_luma8().save(at("grey.jpg")).unwrap();
    image::DynamicImage::ImageRgb8(picture(2)).to_rgb16().save(at("sixteen.png")).unwrap();
    image::DynamicImage::ImageRgb8(picture(3)).to_luma16().save(at("sixteen-grey.png")).unwrap();
    image::DynamicImage::ImageRgb8(picture(4)).to_rgba8().save(at("alpha.png")).unwrap();
    // Inks of a press: cyan, magenta, yellow, black.
    let inks: Vec<u8> = picture(5).pixels().flat_map(|p| [255 - p[0], 255 - p[1], 255 - p[2], 0]).collect();
    let mut press = Vec::new();
    jpeg_encoder::Encoder::new(&mut press, 90).encode(&inks, 150, 120, jpeg_encoder::ColorType::Cmyk).unwrap();
    fs::write(at("press.jpg"), press).unwrap();
    // A huge photo, and a file that only claims to be one.
    image::imageops::resize(&picture(6), 9000, 6000, image::imageops::FilterType::Nearest).save(at("huge.jpg")).unwrap();
    let mut claim = fs::read(at("alpha.png")).unwrap();
    claim[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
    fs::write(at("claim.png"), claim).unwrap();
    photo(photos.path(), "tiny.png", 7);
    picture(7).save(at("good.jpg")).unwrap();
    image::RgbImage::from_pixel(1, 1, image::Rgb([9, 200, 9])).save(at("one-pixel.png")).unwrap();
    let whole = fs::read(at("good.jpg")).unwrap();
    fs::write(at("cut.jpg"), &whole[..whole.len() / 3]).unwrap();
    fs::write(at("header-only.jpg"), &whole[..40]).unwrap();
    let out = tempfile::tempdir().unwrap();
    let manifest = generated(photos.path(), out.path(), 120);
    let skipped: Vec<&str> = manifest.backgrounds.skipped.iter().map(String::as_str).collect();
    assert!(skipped.contains(&"claim.png") && skipped.contains(&"header-only.jpg"), "{skipped:?}");
    let dataset = Dataset::open(out.path()).unwrap();
    let used: BTreeSet<String> = Split::ALL.iter().flat_map(|s| dataset.records(*s).unwrap()).filter_map(|r| r.background).collect();
    for name in ["grey.png", "grey.jpg", "sixteen.png", "sixteen-grey.png", "alpha.png", "press.jpg", "huge.jpg", "one-pixel.png"] {
        assert!(used.contains(name) || skipped.contains(&name), "{name} is neither used nor named: {used:?} {skipped:?}");
    }
    for name in ["grey.png", "sixteen.png", "alpha.png", "huge.jpg"] {
        assert!(used.contains(name), "{name} was skipped: {skipped:?}");
    }
    assert_eq!(dataset.records(Split::Train).unwrap().len(), 84);
}

#[test]
fn near_duplicates_stand_in_one_split() {
    let photos = tempfile::tempdir().unwrap();
    let mut twins = Vec::new();
    for k in 0..30u8 {
        let name = |what: &str| format!("{k:02}-{what}.png");
        photo(photos.path(), &name("first"), k);
        // The same scene a moment later: another size, a little brighter.
        let small = image::imageops::resize(&picture(k.into()), 110, 88, image::imageops::FilterType::Triangle);
        image::imageops::brighten(&small, 5).save(photos.path().join(name("second"))).unwrap();
        twins.push(vec![name("first"), name("second")]);
    }
    let out = tempfile::tempdir().unwrap();
    let manifest = generated(photos.path(), out.path(), 300);
    assert_eq!(manifest.backgrounds.near_duplicates, twins);
    let dataset = Dataset::open(out.path()).unwrap();
    let scenes = Split::ALL.map(|s| {
        let names = dataset.records(s).unwrap().into_iter().filter_map(|r| Some(r.background?[..2].to_owned()));
        names.collect::<BTreeSet<String>>()
    });
    assert!(scenes.iter().all(|s| !s.is_empty()));
    assert!(scenes[0].is_disjoint(&scenes[1]) && scenes[0].is_disjoint(&scenes[2]) && scenes[1].is_disjoint(&scenes[2]), "{scenes:?}");
}
