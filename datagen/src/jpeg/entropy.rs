//! Huffman codes and the bits of the file.
use super::{
    tables::{AC, Code, DC},
    transform::Group,
};

/// The most bytes a block can take: 64 coefficients of 27 bits.
const BLOCK_BYTES: usize = 64 * 27 / 8;

/// Codes of one kind of component.
pub struct Codes {
    dc: [u32; 256],
    ac: [u32; 256],
}

/// A symbol's code, shifted to make room for the bits of the number that follows, and the length of both in the lowest five bits.
/// The low four bits of a symbol are the number of those bits.
fn merged(code: &Code) -> [u32; 256] {
    let mut merged = [0; 256];
    let (mut next, mut symbols) = (0u32, code.symbols.iter());
    for (bits, count) in (1..).zip(code.lengths) {
        for symbol in symbols.by_ref().take(count.into()) {
            let follow = u32::from(symbol & 15);
            merged[usize::from(*symbol)] = (next << follow) << 5 | (bits + follow);
            next += 1;
        }
        next <<= 1;
    }
    merged
}

impl Codes {
    /// For luma (0) or chroma (1).
    pub fn new(component: usize) -> Self {
        Self { dc: merged(&DC[component]), ac: merged(&AC[component]) }
    }
}

/// Bits on their way to bytes. A 0xff in the stream is followed by a zero, so that it cannot be taken for a marker; these are put in strip by strip
/// and not bit by bit.
pub struct BitWriter {
    /// The newest bits, the last one lowest; above the `held` ones is rubbish.
    bits: u64,
    /// Bits that are not in `bytes` as part of a whole byte: 0 to 7 between two codes.
    held: u32,
    /// Whole bytes so far, and eight more that may be written over.
    bytes: Vec<u8>,
    end: usize,
}

impl BitWriter {
    /// With room for `blocks` blocks from one [`BitWriter::flush`] to the next.
    pub fn new(blocks: usize) -> Self {
        Self { bits: 0, held: 0, bytes: vec![0; blocks * BLOCK_BYTES + 8], end: 0 }
    }

    /// Appends the lowest `length` bits, 1 to 27, of `code`, which has no others.
    #[inline(always)]
    fn put(&mut self, code: u32, length: u32) {
        self.bits = self.bits << length | u64::from(code);
        self.held += length;
        // All that is held is written, and what does not fill a byte is written again with the next.
        if let Some(place) = self.bytes.get_mut(self.end..self.end + 8) {
            place.copy_from_slice(&(self.bits << (64 - self.held)).to_be_bytes());
        }
        self.end += (self.held / 8) as usize;
        self.held %= 8;
    }

    /// Appends a number after the code of `16 * zeros + its number of bits`.
    #[inline(always)]
    fn put_number(&mut self, codes: &[u32; 256], zeros: u32, number: i32) {
        let size = 32 - number.unsigned_abs().leading_zeros();
        let entry = codes[(zeros * 16 + size) as usize & 255];
        // A negative number is written less one, in as many bits.
        let low = (number + (number >> 31)) as u32 & ((1 << size) - 1);
        self.put(entry >> 5 | low, entry & 31);
    }

    /// Appends a block: its first coefficient as the difference to the last block's, the others as runs of zeros and numbers.
    #[inline(always)]
    pub fn put_block(&mut self, group: &Group, block: usize, last: &mut i32, codes: &Codes) {
        let first = i32::from(group.value(block, 0));
        self.put_number(&codes.dc, 0, first - *last);
        *last = first;
        let mut coded = group.coded(block) & !1;
        let mut behind = 1;
        while coded != 0 {
            let k = coded.trailing_zeros();
            let mut zeros = k - behind;
            while zeros > 15 {
                self.put(codes.ac[0xf0] >> 5, codes.ac[0xf0] & 31);
                zeros -= 16;
            }
            self.put_number(&codes.ac, zeros, group.value(block, k as usize).into());
            behind = k + 1;
            coded &= coded - 1;
        }
        if behind < 64 {
            self.put(codes.ac[0] >> 5, codes.ac[0] & 31);
        }
    }

    /// Moves the whole bytes to the file.
    #[inline(always)]
    pub fn flush(&mut self, file: &mut Vec<u8>) {
        let (chunks, rest) = self.bytes[..self.end].as_chunks::<16>();
        file.reserve(2 * self.end);
        for chunk in chunks {
            if chunk.iter().fold(false, |found, byte| found | (*byte == 0xff)) {
                stuffed(chunk, file);
            } else {
                file.extend_from_slice(chunk);
            }
        }
        stuffed(rest, file);
        self.end = 0;
    }

    /// Fills the last byte up with ones.
    pub fn finish(mut self, file: &mut Vec<u8>) {
        self.put(0x7f, 7);
        self.flush(file);
    }
}

#[inline(always)]
fn stuffed(bytes: &[u8], file: &mut Vec<u8>) {
    for byte in bytes {
        file.push(*byte);
        if *byte == 0xff {
            file.push(0);
        }
    }
}
