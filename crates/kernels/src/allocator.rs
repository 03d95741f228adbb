//! A global allocator that re-uses large buffers.
//!
//! A training step takes and frees the same few hundred megabytes again and again. The system's allocator gives such blocks back to the
//! kernel, which clears every page anew: on a CPU that costs as much as much of the arithmetic. [`Pool`] keeps freed blocks of at least
//! 64 KiB in lists by size class (eighths of a power of two) and hands them out again; everything smaller goes to the system. It keeps
//! them only while someone asks for it ([`keep`]), as a training does: work whose buffers differ from one piece to the next, as images
//! being drawn, would gather blocks of ever more sizes. What it holds is bounded by what was in use at the peak and a quarter more.
//!
//! ```
//! use tcross_kernels::allocator::{Pool, keep};
//! #[global_allocator]
//! static POOL: Pool = Pool::new();
//! # fn main() {
//! let _kept = keep(); // From here to the end of the scope freed blocks are used again.
//! assert_eq!(vec![0u8; 1 << 20].len(), 1 << 20);
//! # }
//! ```
use std::{
    alloc::{GlobalAlloc, Layout, System},
    ptr,
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
};

/// Blocks below this many bytes are the system's.
const LEAST: usize = 64 * 1024;
/// All pooled blocks have this alignment: a cache line, and the widest vector.
const ALIGN: usize = 64;
/// Size classes: eight a power of two, from 2^16 on; larger blocks than the last class are the system's.
const CLASSES: usize = 8 * 24;

/// How many [`Keep`] live.
static KEEPERS: AtomicUsize = AtomicUsize::new(0);

/// While one lives, pools keep what is freed.
#[derive(Debug)]
#[must_use = "blocks are kept only as long as this lives"]
pub struct Keep(());

/// Asks every [`Pool`] to keep freed blocks until the answer is dropped. Blocks kept until then are still handed out after it, and go back to
/// the system when they are freed.
pub fn keep() -> Keep {
    KEEPERS.fetch_add(1, Ordering::Relaxed);
    Keep(())
}

/// Whether freed blocks are kept at the moment.
#[must_use]
pub fn is_kept() -> bool {
    KEEPERS.load(Ordering::Relaxed) > 0
}

impl Drop for Keep {
    fn drop(&mut self) {
        KEEPERS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// See the module.
pub struct Pool {
    busy: AtomicBool,
    /// Heads of the lists of free blocks; a free block's first word points to the next.
    free: [AtomicUsize; CLASSES],
    /// Bytes in free blocks.
    held: AtomicUsize,
    /// Bytes of pooled blocks in use.
    used: AtomicUsize,
    /// The most that was ever in use.
    peak: AtomicUsize,
}

impl Default for Pool {
    fn default() -> Self {
        Self::new()
    }
}

impl Pool {
    /// An empty pool.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            busy: AtomicBool::new(false),
            free: [const { AtomicUsize::new(0) }; CLASSES],
            held: AtomicUsize::new(0),
            used: AtomicUsize::new(0),
            peak: AtomicUsize::new(0),
        }
    }

    /// The class of a size and the bytes of its blocks; `None` for what is the system's.
    fn class(layout: Layout) -> Option<(usize, usize)> {
        let size = layout.size();
        if size < LEAST || layout.align() > ALIGN {
            return None;
        }
        let power = (usize::BITS - 1 - (size - 1).leading_zeros()) as usize;
        let eighth = 1usize << (power - 3);
        // 1..=8 eighths above the power of two below `size`.
        let steps = (size - (1 << power)).div_ceil(eighth).max(1);
        let class = (power - 15) * 8 + steps - 1;
        (class < CLASSES).then_some((class, (1 << power) + steps * eighth))
    }

    fn lock(&self) -> Guard<'_> {
        // Held for a few instructions, a few hundred times a step.
        while self.busy.compare_exchange_weak(false, true, Ordering::Acquire, Ordering::Relaxed).is_err() {
            std::hint::spin_loop();
        }
        Guard(self)
    }

    fn take(&self, class: usize, bytes: usize) -> *mut u8 {
        {
            let _guard = self.lock();
            let used = self.used.load(Ordering::Relaxed) + bytes;
            self.used.store(used, Ordering::Relaxed);
            self.peak.fetch_max(used, Ordering::Relaxed);
            let head = self.free[class].load(Ordering::Relaxed) as *mut u8;
            if !head.is_null() {
                // SAFETY: a block in the list is ours alone and its first word is the next block's address.
                let next = unsafe { head.cast::<usize>().read() };
                self.free[class].store(next, Ordering::Relaxed);
                self.held.fetch_sub(bytes, Ordering::Relaxed);
                return head;
            }
        }
        // SAFETY: the size is not zero and the alignment a power of two.
        unsafe { System.alloc(Layout::from_size_align_unchecked(bytes, ALIGN)) }
    }

    fn give(&self, block: *mut u8, class: usize, bytes: usize) {
        {
            let _guard = self.lock();
            let used = self.used.load(Ordering::Relaxed) - bytes;
            self.used.store(used, Ordering::Relaxed);
            let peak = self.peak.load(Ordering::Relaxed);
            // A quarter more than the peak: forward and backward passes want different classes, and should not hand theirs to and fro.
            if is_kept() && used + self.held.load(Ordering::Relaxed) + bytes <= peak + peak / 4 {
                // SAFETY: the caller freed the block, which has at least 64 KiB.
                unsafe { block.cast::<usize>().write(self.free[class].load(Ordering::Relaxed)) };
                self.free[class].store(block as usize, Ordering::Relaxed);
                self.held.fetch_add(bytes, Ordering::Relaxed);
                return;
            }
        }
        // SAFETY: it came from the system with this layout.
        unsafe { System.dealloc(block, Layout::from_size_align_unchecked(bytes, ALIGN)) }
    }
}

struct Guard<'a>(&'a Pool);

impl Drop for Guard<'_> {
    fn drop(&mut self) {
        self.0.busy.store(false, Ordering::Release);
    }
}

// SAFETY: a block goes to one owner at a time: it leaves its list under the lock before it is handed out, and enters it when freed. Every
// layout maps to the same class when it is taken and when it is given back.
unsafe impl GlobalAlloc for Pool {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        match Self::class(layout) {
            Some((class, bytes)) => self.take(class, bytes),
            // SAFETY: the caller's contract.
            None => unsafe { System.alloc(layout) },
        }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        match Self::class(layout) {
            Some((class, bytes)) => self.give(block, class, bytes),
            // SAFETY: the caller's contract.
            None => unsafe { System.dealloc(block, layout) },
        }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        match Self::class(layout) {
            Some((class, bytes)) => {
                let block = self.take(class, bytes);
                if !block.is_null() {
                    // SAFETY: the block has at least that many bytes.
                    unsafe { ptr::write_bytes(block, 0, layout.size()) };
                }
                block
            }
            // SAFETY: the caller's contract.
            None => unsafe { System.alloc_zeroed(layout) },
        }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // SAFETY: the alignment is a power of two; the caller vouches for the size.
        let new_layout = unsafe { Layout::from_size_align_unchecked(new_size, layout.align()) };
        match (Self::class(layout), Self::class(new_layout)) {
            // SAFETY: the caller's contract.
            (None, None) => unsafe { System.realloc(block, layout, new_size) },
            (Some(old), Some(new)) if old == new => block,
            // SAFETY: the old block is alive until it is freed here; both have the bytes that are copied.
            _ => unsafe {
                let moved = self.alloc(new_layout);
                if !moved.is_null() {
                    ptr::copy_nonoverlapping(block, moved, layout.size().min(new_size));
                    self.dealloc(block, layout);
                }
                moved
            },
        }
    }
}

/// The system's allocator, counting: for tests that something takes no memory.
pub struct Counted {
    taken: AtomicUsize,
}

impl Default for Counted {
    fn default() -> Self {
        Self::new()
    }
}

impl Counted {
    /// Nothing counted yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { taken: AtomicUsize::new(0) }
    }

    /// Blocks taken so far, by all threads.
    #[must_use]
    pub fn taken(&self) -> usize {
        self.taken.load(Ordering::Relaxed)
    }
}

// SAFETY: every call goes on to the system's allocator.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        self.taken.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract.
        unsafe { System.dealloc(block, layout) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// Keeping holds for the whole program, so that tests of it take turns.
    static KEEPING: Mutex<()> = Mutex::new(());

    #[test]
    fn classes_hold_their_sizes() {
        let mut last = (0, 0);
        for size in (LEAST..LEAST * 40).step_by(997).chain([LEAST, 2 * LEAST, 2 * LEAST + 1, 1 << 30]) {
            let (class, bytes) = Pool::class(Layout::from_size_align(size, 8).unwrap()).unwrap();
            assert!(bytes >= size && bytes as f64 <= size as f64 * 1.15, "{size} in {bytes}");
            if bytes > last.1 {
                assert!(class > last.0 || last.1 == 0);
                last = (class, bytes);
            }
        }
        assert!(Pool::class(Layout::from_size_align(LEAST - 1, 8).unwrap()).is_none());
    }

    #[test]
    fn blocks_come_back_while_kept_and_memory_is_bounded() {
        let pool = Pool::new();
        let layout = Layout::from_size_align(1 << 20, 16).unwrap();
        let _alone = KEEPING.lock().unwrap();
        // SAFETY: the block is freed once with the layout it was taken with.
        unsafe { pool.dealloc(pool.alloc(layout), layout) };
        assert_eq!(pool.held.load(Ordering::Relaxed), 0, "nobody keeps anything yet");
        let kept = keep();
        // SAFETY: every block is freed once with the layout it was taken with, and written only within its size.
        unsafe {
            let first = pool.alloc(layout);
            first.write_bytes(7, 1 << 20);
            pool.dealloc(first, layout);
            let again = pool.alloc_zeroed(layout);
            assert_eq!(again, first);
            assert!((0..1 << 20).all(|k| again.add(k).read() == 0));
            let grown = pool.realloc(again, layout, 3 << 20);
            pool.dealloc(grown, Layout::from_size_align(3 << 20, 16).unwrap());
        }
        assert_eq!(pool.used.load(Ordering::Relaxed), 0);
        let held = pool.held.load(Ordering::Relaxed);
        assert!(held > 0 && held <= pool.peak.load(Ordering::Relaxed) / 4 * 5);
        drop(kept);
        // SAFETY: as above.
        unsafe { pool.dealloc(pool.alloc(layout), layout) };
        assert!(pool.held.load(Ordering::Relaxed) < held, "a kept block that is used once more goes back to the system");
    }

    #[test]
    fn threads_share_it() {
        static POOL: Pool = Pool::new();
        let _alone = KEEPING.lock().unwrap();
        let _kept = keep();
        std::thread::scope(|scope| {
            for t in 0..4usize {
                scope.spawn(move || {
                    for k in 0..500 {
                        let layout = Layout::from_size_align(LEAST + 4096 * ((k * 7 + t) % 50), 8).unwrap();
                        // SAFETY: as above.
                        unsafe {
                            let block = POOL.alloc(layout);
                            block.write_bytes(t as u8, layout.size());
                            assert!([0, layout.size() / 2, layout.size() - 1].iter().all(|&i| block.add(i).read() == t as u8));
                            POOL.dealloc(block, layout);
                        }
                    }
                });
            }
        });
    }
}
