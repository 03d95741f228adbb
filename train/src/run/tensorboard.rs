//! TensorBoard event files: records of length, masked CRC-32C and a protobuf message, written by hand.
use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};
use tcross_dataset::DatasetError;

/// An event file that grows.
pub struct EventFile {
    file: BufWriter<File>,
    path: PathBuf,
}

impl EventFile {
    /// Starts a file whose name sorts by `step`. TensorBoard reads all files of a folder as one run.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(dir: &Path, step: u64) -> Result<Self, DatasetError> {
        let path = dir.join(format!("events.out.tfevents.{step:010}"));
        let file = BufWriter::new(File::create(&path).map_err(|e| DatasetError::io(&path, e))?);
        let mut events = Self { file, path };
        events.put(&event(0.0, 0, &[(3, b"brain.Event:2")])).map_err(|e| DatasetError::io(&events.path, e))?;
        Ok(events)
    }

    /// Writes numbers of one step; `seconds` stands in for wall time.
    ///
    /// # Errors
    /// If the disk is full.
    pub fn scalars(&mut self, step: u64, seconds: f64, values: &[(String, f64)]) -> Result<(), DatasetError> {
        let mut summary = Vec::new();
        for (tag, value) in values {
            let mut entry = Vec::new();
            bytes_field(&mut entry, 1, tag.as_bytes());
            entry.push(2 << 3 | 5); // simple_value, 32 bits
            entry.extend((*value as f32).to_le_bytes());
            bytes_field(&mut summary, 1, &entry);
        }
        let put = self.put(&event(seconds, step, &[(5, &summary)])).and_then(|()| self.file.flush());
        put.map_err(|e| DatasetError::io(&self.path, e))
    }

    fn put(&mut self, message: &[u8]) -> io::Result<()> {
        let length = (message.len() as u64).to_le_bytes();
        self.file.write_all(&length)?;
        self.file.write_all(&masked_crc(&length).to_le_bytes())?;
        self.file.write_all(message)?;
        self.file.write_all(&masked_crc(message).to_le_bytes())
    }
}

/// An `Event`: wall_time (1, double), step (2, varint), and fields of bytes.
fn event(wall_time: f64, step: u64, fields: &[(u8, &[u8])]) -> Vec<u8> {
    let mut message = vec![1 << 3 | 1];
    message.extend(wall_time.to_le_bytes());
    message.push(2 << 3);
    varint(&mut message, step);
    fields.iter().for_each(|(field, bytes)| bytes_field(&mut message, *field, bytes));
    message
}

fn bytes_field(message: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    message.push(field << 3 | 2);
    varint(message, bytes.len() as u64);
    message.extend(bytes);
}

fn varint(message: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        message.push(value as u8 | 0x80);
        value >>= 7;
    }
    message.push(value as u8);
}

fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

fn crc32c(bytes: &[u8]) -> u32 {
    let step =
        |crc: u32, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 });
    !bytes.iter().fold(!0, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_of_the_standards_words() {
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
    }

    #[test]
    fn records_can_be_walked_and_hold_the_value() {
        let dir = tempfile::tempdir().unwrap();
        EventFile::create(dir.path(), 7).unwrap().scalars(300, 1.5, &[("loss/sum".into(), 2.5)]).unwrap();
        let bytes = std::fs::read(dir.path().join("events.out.tfevents.0000000007")).unwrap();
        let (mut at, mut messages) = (0, Vec::new());
        while at < bytes.len() {
            let length = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
            let message = &bytes[at + 12..at + 12 + length];
            assert_eq!(bytes[at + 12 + length..at + 16 + length], masked_crc(message).to_le_bytes());
            messages.push(message.to_vec());
            at += 16 + length;
        }
        assert_eq!(messages.len(), 2);
        // wall_time 1.5, step 300 = 0xac 0x02, summary of 17 bytes, value of 15: tag, then 2.5 as a float.
        let mut want = vec![0x09];
        want.extend(1.5f64.to_le_bytes());
        want.extend([0x10, 0xac, 0x02, 0x2a, 17, 0x0a, 15, 0x0a, 8]);
        want.extend(b"loss/sum");
        want.push(0x15);
        want.extend(2.5f32.to_le_bytes());
        assert_eq!(messages[1], want);
    }
}
