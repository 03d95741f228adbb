//! A warm network takes no memory: a program of its own, since it counts what the whole process allocates.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
use tcross_kernels::allocator::Counted;
use tcross_yolo::{Architecture, InferenceNet, ModelConfig, NetSize, Weights};

#[global_allocator]
static ALLOCATOR: Counted = Counted::new();

#[test]
fn a_warm_network_allocates_nothing() {
    for architecture in [Architecture::YoloV3, Architecture::YoloV3Tiny] {
        let net = NetSize { width: 128, height: 96 };
        let config = ModelConfig { width: 0.125, input: net, classes: 2, ..ModelConfig::of(architecture) };
        let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 3);
        let mut network = InferenceNet::new(&config, &weights).unwrap();
        let image = vec![0.5; 3 * 128 * 96];
        // Which thread takes which part is chance, and each keeps scratch for the largest part it has met: some window must be quiet.
        let quietest = (0..20).map(|_| {
            let before = ALLOCATOR.taken();
            (0..10).for_each(|_| {
                network.run(&image, net);
            });
            ALLOCATOR.taken() - before
        });
        assert_eq!(quietest.min(), Some(0), "{architecture:?}: allocations in ten warm frames");
    }
}
