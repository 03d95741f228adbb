//! YOLOv3 and yolov3-tiny: network, weights, loss, decoding.
