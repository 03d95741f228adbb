//! Batches, made by threads of their own while the steps compute.
use super::{order::Order, samples::Samples};
use crate::{
    augment::{Input, Labels, Plan},
    config::Augment,
};
use std::{
    collections::VecDeque,
    sync::{
        Arc,
        mpsc::{Receiver, Sender, channel},
    },
    thread::JoinHandle,
};
use tcross_dataset::Rng;
use tcross_yolo::Truth;

/// What a step learns from.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch {
    /// What it answers.
    pub request: Request,
    /// For each picture, the images of the set that it was made of: one, or several for a mosaic or a mix.
    pub sources: Vec<Vec<usize>>,
    /// `[batch, 3, height, width]`, 0..1.
    pub images: Vec<f32>,
    /// One list an image.
    pub truths: Vec<Vec<Truth>>,
}

impl Batch {
    /// Cuts it into `count` batches of about the same size, the larger first.
    #[must_use]
    pub fn parts(mut self, count: usize) -> Vec<Self> {
        let length = self.images.len() / self.truths.len().max(1);
        let mut parts = Vec::with_capacity(count);
        for left in (1..=count).rev() {
            let size = self.truths.len().div_ceil(left);
            let rest = Self {
                request: self.request,
                sources: self.sources.split_off(size.min(self.sources.len())),
                images: self.images.split_off(size * length),
                truths: self.truths.split_off(size),
            };
            parts.push(std::mem::replace(&mut self, rest));
        }
        parts
    }
}

/// Asks for the batch of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request {
    /// 0-based.
    pub step: u64,
    /// What it shows.
    pub input: Input,
}

/// Makes batches: each a function of (seed, request) alone.
#[derive(Clone)]
pub struct BatchMaker {
    /// Where images come from.
    pub samples: Arc<Samples>,
    /// Which image comes when.
    pub order: Order,
    /// What is done to them.
    pub augment: Augment,
    /// Images in a batch.
    pub batch: usize,
    /// Points of a marker that are learned besides its box: the first so many of its centre and corners.
    pub keypoints: usize,
    /// Of the training.
    pub seed: u64,
}

impl BatchMaker {
    /// Makes one batch.
    pub fn make(&mut self, request: Request) -> Batch {
        let Request { step, input } = request;
        let net = input.net;
        let length = 3 * net.width * net.height;
        let mut images = vec![0.0; self.batch * length];
        let pictures = images.chunks_exact_mut(length).enumerate().map(|(k, out)| {
            let position = step * self.batch as u64 + k as u64;
            let mut rng = Rng::for_item(self.seed, "train/augment", position);
            let set: &dyn Labels = &*self.samples;
            let plan = Plan::sample(&self.augment, set, self.order.at(position), input, &mut rng);
            let sources = plan.pictures.iter().flat_map(|picture| &picture.tiles).map(|tile| tile.image).collect();
            let mut truths = plan.render(set, &mut |index| self.samples.read(index), out);
            truths.iter_mut().for_each(|truth| truth.keypoints.truncate(self.keypoints));
            (sources, truths)
        });
        let (sources, truths) = pictures.unzip();
        Batch { request, sources, images, truths }
    }
}

/// Makes batches in the order in which they were asked for: ahead of the steps in threads of their own, or without any when they are
/// received.
pub struct Loader {
    workers: Vec<Worker>,
    maker: BatchMaker,
    /// Pending requests and which worker has each, oldest first.
    pending: VecDeque<(usize, Request)>,
    next: usize,
}

struct Worker {
    requests: Option<Sender<Request>>,
    batches: Receiver<Batch>,
    thread: Option<JoinHandle<()>>,
}

impl Loader {
    /// Starts `workers` threads; with 0 the caller's own makes the batches.
    #[must_use]
    pub fn start(maker: &BatchMaker, workers: usize) -> Self {
        let worker = |_| {
            let mut maker = maker.clone();
            let (requests, asked) = channel::<Request>();
            let (made, batches) = channel();
            let thread = std::thread::spawn(move || {
                while let Ok(request) = asked.recv() {
                    if made.send(maker.make(request)).is_err() {
                        break;
                    }
                }
            });
            Worker { requests: Some(requests), batches, thread: Some(thread) }
        };
        Self { workers: (0..workers).map(worker).collect(), maker: maker.clone(), pending: VecDeque::new(), next: 0 }
    }

    /// How many batches to ask for ahead: one in work and one ready for each thread.
    #[must_use]
    pub fn ahead(&self) -> usize {
        self.workers.len() + 1
    }

    /// Requests not yet answered.
    #[must_use]
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Asks for a batch.
    pub fn request(&mut self, request: Request) {
        let worker = self.next % self.workers.len().max(1);
        self.next += 1;
        let taken = match self.workers.get(worker) {
            Some(Worker { requests: Some(requests), .. }) => requests.send(request).is_ok(),
            Some(_) => false,
            None => true, // made when received
        };
        if taken {
            self.pending.push_back((worker, request));
        }
    }

    /// Waits for the oldest request; none if nothing was asked for, or a worker has died.
    pub fn receive(&mut self) -> Option<Batch> {
        let (worker, request) = self.pending.pop_front()?;
        match self.workers.get(worker) {
            Some(worker) => worker.batches.recv().ok(),
            None => Some(self.maker.make(request)),
        }
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        for worker in &mut self.workers {
            worker.requests = None; // ends its loop
            if let Some(thread) = worker.thread.take() {
                let _ = thread.join(); // a panic there has been printed
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{augment::View, toy};
    use tcross_dataset::{Dataset, Split};
    use tcross_yolo::NetSize;

    #[test]
    fn batches_do_not_depend_on_who_makes_them() {
        let dir = tempfile::tempdir().unwrap();
        toy::write(dir.path(), 10, 2, 32).unwrap();
        let samples = Samples::open(&Dataset::open(dir.path()).unwrap(), Split::Train, NetSize::square(32), &[], 1 << 20).unwrap();
        let marked = vec![true; 10];
        let mut maker = BatchMaker {
            samples: Arc::new(samples),
            order: Order::new(3, &marked, None),
            augment: Augment { mosaic: 0.5, mixup: 0.5, ..Augment::default() },
            batch: 4,
            keypoints: 1,
            seed: 3,
        };
        let request = |step| {
            let (net, view) = if step % 2 == 0 { (32, View::Whole) } else { (64, View::Window { focus: 0.5 }) };
            Request { step, input: Input { net: NetSize::square(net), view, fraction: 0.0 } }
        };
        let alone: Vec<Batch> = (0..6).map(|step| maker.make(request(step))).collect();
        for workers in [0, 1, 3] {
            let mut loader = Loader::start(&maker, workers);
            (0..6).for_each(|step| loader.request(request(step)));
            let together: Vec<Batch> = (0..6).map(|_| loader.receive().unwrap()).collect();
            assert_eq!(alone, together);
            assert!(loader.receive().is_none());
        }
        assert!(alone.iter().flat_map(|batch| &batch.sources).all(|images| !images.is_empty() && images.iter().all(|&i| i < 10)));
        // A later step alone, as after a resume.
        assert_eq!(Loader::start(&maker, 1).pending(), 0);
        assert_eq!(maker.clone().make(request(4)), alone[4]);
    }
}
