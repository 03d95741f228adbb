//! Deals the images of a set anew to train, validation and test.
use crate::{
    Record, Rng, Split,
    formats::{Gathering, Item, Labelled},
    picture,
    similar::{self, Look},
};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Deals images by `parts` (train : val : test, not all zero), in an order drawn from `seed`. Images that share a photo, are frames of one
/// video or show nearly the same ([`similar`]) stay together, so none is in two splits; the parts are therefore met only as closely as that
/// allows. Names stay as they were; one that would occur twice gets its old split's name in front. A picture that cannot be read is dealt
/// by its record alone.
#[must_use]
pub fn resplit(set: &Labelled, parts: [u32; 3], seed: u64) -> Labelled {
    let items: Vec<(Split, &Item)> = set.items().collect();
    let looks: Vec<Option<Look>> = items.par_iter().map(|(_, item)| Some(Look::of(&picture::read(&item.picture).ok()?))).collect();
    let keys: Vec<String> = items.iter().map(|(split, item)| source(*split, &item.record)).collect();
    let mut first_of: BTreeMap<&str, usize> = BTreeMap::new();
    let of_one_source = keys.iter().enumerate().map(|(k, key)| (k, *first_of.entry(key).or_insert(k)));
    let of_one_look = similar::groups(&looks).into_iter().enumerate();
    let group = similar::joined(items.len(), of_one_source.chain(of_one_look));
    let mut groups: BTreeMap<&str, Vec<(Split, &Item)>> = BTreeMap::new();
    for (item, group) in items.iter().zip(group) {
        groups.entry(&keys[group]).or_default().push(*item);
    }
    let mut groups: Vec<_> = groups.into_values().collect();
    Rng::for_item(seed, "dataset/resplit", 0).shuffle(&mut groups);

    let (sum, images) = (f64::from(parts.iter().sum::<u32>()), set.items().count() as f64);
    let mut dealt: [Vec<(Split, &Item)>; 3] = Default::default();
    for group in groups {
        // The split that lacks most of its share takes the next photo; the earlier of two that lack the same.
        let lack = |k: usize| f64::from(parts[k]) / sum * images - dealt[k].len() as f64;
        let neediest = (0..3).filter(|k| parts[*k] > 0).max_by(|a, b| lack(*a).total_cmp(&lack(*b)).then(b.cmp(a)));
        dealt[neediest.unwrap_or(0)].extend(group);
    }
    let mut out = Gathering::new(set.boxes);
    for (split, mut items) in Split::ALL.into_iter().zip(dealt) {
        items.sort_by_key(|(old, item)| (*old, &item.record.image));
        for (old, item) in items {
            out.add(split, item.clone(), old.name());
        }
    }
    out.finish()
}

/// What an image was made from: a photo, a video, or itself.
fn source(split: Split, record: &Record) -> String {
    let video = record.effects.get("video").and_then(|v| v.get("sequence"));
    match (record.photo(), video) {
        (Some(photo), _) => format!("photo {photo}"),
        (None, Some(sequence)) => format!("video {sequence}"),
        (None, None) => format!("image {split} {}", record.image),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::BoxConvention, files, formats};

    /// Bursts of three of real annotated photos, which name no common source.
    #[test]
    fn pictures_that_show_nearly_the_same_stay_together() {
        let dir = tempfile::tempdir().unwrap();
        let set = formats::tests::random_set(dir.path(), 1, BoxConvention::Continuous);
        let template = Record { background: None, markers: Vec::new(), ..set.splits[&Split::Train][0].record.clone() };
        files::create_dir(dir.path().join("burst")).unwrap();
        let rows = (0..30u64).map(|k| {
            let (scene, shot) = (k / 3, k % 3);
            let mut rng = Rng::for_item(scene, "test/resplit", 0);
            let cells: Vec<[u8; 3]> = (0..256).map(|_| [0; 3].map(|_| rng.int(20, 230) as u8)).collect();
            let picture =
                image::RgbImage::from_fn(160, 160, |x, y| image::Rgb(cells[(y / 10 * 16 + x / 10) as usize].map(|v| v + shot as u8)));
            let image = format!("burst/{k:05}.png");
            picture.save(dir.path().join(&image)).unwrap();
            Record { image, width: 160, height: 160, ..template.clone() }
        });
        let set = Labelled::in_folder(dir.path(), set.boxes, [(Split::Train, rows.collect())].into());
        let mut home: BTreeMap<usize, Split> = BTreeMap::new();
        let dealt = resplit(&set, [1, 1, 1], 3);
        for (split, record) in dealt.records() {
            let number: usize = record.image[record.image.len() - 9..record.image.len() - 4].parse().unwrap();
            assert_eq!(*home.entry(number / 3).or_insert(split), split, "{}", record.image);
        }
        assert!(dealt.splits.values().all(|items| (9..=12).contains(&items.len())));
    }

    #[test]
    fn photos_stay_together_and_parts_are_met() {
        let dir = tempfile::tempdir().unwrap();
        let mut set = formats::tests::random_set(dir.path(), 1, BoxConvention::Continuous);
        let template = set.splits[&Split::Train][0].record.clone();
        let rows = (0..400).map(|k| Record {
            image: format!("train/{k:05}.jpg"),
            background: Some(format!("photo{}.jpg", k / 4)),
            ..template.clone()
        });
        set = Labelled::in_folder(dir.path(), set.boxes, [(Split::Train, rows.collect())].into());
        let dealt = resplit(&set, [7, 2, 1], 3);
        assert_eq!(dealt.splits.values().map(Vec::len).collect::<Vec<_>>(), [280, 80, 40]);
        let mut home: BTreeMap<&str, Split> = BTreeMap::new();
        for (split, record) in dealt.records() {
            assert_eq!(*home.entry(record.background.as_deref().unwrap()).or_insert(split), split);
        }
        assert_eq!(dealt, resplit(&set, [7, 2, 1], 3));
        assert_ne!(dealt, resplit(&set, [7, 2, 1], 4));
    }

    #[test]
    fn frames_of_a_video_stay_together() {
        let dir = tempfile::tempdir().unwrap();
        let set = formats::tests::random_set(dir.path(), 1, BoxConvention::Continuous);
        let template = Record { background: Some("embedded/room".into()), ..set.splits[&Split::Train][0].record.clone() };
        let rows = (0..60).map(|k| {
            let mut record = Record { image: format!("train/{k:05}.jpg"), ..template.clone() };
            record.effects.insert("video".into(), serde_json::json!({ "sequence": k / 6 }));
            record
        });
        let set = Labelled::in_folder(dir.path(), set.boxes, [(Split::Train, rows.collect())].into());
        let mut home: BTreeMap<u64, Split> = BTreeMap::new();
        for (split, record) in resplit(&set, [1, 1, 0], 3).records() {
            let sequence = record.effects["video"]["sequence"].as_u64().unwrap();
            assert_eq!(*home.entry(sequence).or_insert(split), split);
        }
        assert!(home.values().any(|s| *s != home[&0]));
    }

    #[test]
    fn names_that_meet_are_kept_apart() {
        let dir = tempfile::tempdir().unwrap();
        let set = formats::tests::random_set(dir.path(), 1, BoxConvention::Continuous);
        let names: Vec<String> = resplit(&set, [1, 0, 0], 1).records().map(|(_, r)| r.image.clone()).collect();
        assert_eq!(names.len(), 9);
        assert!(names.contains(&"train/val-00000.png".into()) && names.contains(&"train/00000.png".into()), "{names:?}");
    }
}
