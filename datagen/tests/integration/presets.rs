use std::path::Path;
use tcross_datagen::Config;

#[test]
fn every_preset_is_valid() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/presets");
    let mut count = 0;
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let mut table: toml::Table = toml::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let config: Config = table.remove("data").unwrap().try_into().unwrap_or_else(|e| panic!("{path:?}: {e}"));
        config.validate().unwrap_or_else(|e| panic!("{path:?}: {e}"));
        count += 1;
    }
    assert!(count >= 2);
}
