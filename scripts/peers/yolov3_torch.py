"""YOLOv3 with a width multiplier, and YOLOv3-tiny, in plain PyTorch.

Own code, written from the published layer tables. Used only to time a peer.
"""
import torch
from torch import nn
import torch.nn.functional as F


def scaled(c, w):
    return max(8, int(c * w / 8 + 0.5) * 8)  # as T-cross: a multiple of 8, at least 8


class Cbl(nn.Module):
    """conv (no bias) + batch norm + leaky relu 0.1"""

    def __init__(self, ci, co, k, s=1):
        super().__init__()
        self.conv = nn.Conv2d(ci, co, k, s, k // 2, bias=False)
        self.bn = nn.BatchNorm2d(co, eps=1e-5, momentum=0.1)

    def forward(self, x):
        return F.leaky_relu(self.bn(self.conv(x)), 0.1, inplace=True)


class Res(nn.Module):
    def __init__(self, c, half):
        super().__init__()
        self.a = Cbl(c, half, 1)
        self.b = Cbl(half, c, 3)

    def forward(self, x):
        return x + self.b(self.a(x))


class Darknet53(nn.Module):
    def __init__(self, w):
        super().__init__()
        ch = [scaled(c, w) for c in (32, 64, 128, 256, 512, 1024)]
        self.stem = Cbl(3, ch[0], 3)
        self.stages = nn.ModuleList()
        for i, n in enumerate((1, 2, 8, 8, 4)):
            self.stages.append(nn.Sequential(
                Cbl(ch[i], ch[i + 1], 3, 2),
                *[Res(ch[i + 1], ch[i]) for _ in range(n)]))

    def forward(self, x):
        x = self.stem(x)
        out = []
        for st in self.stages:
            x = st(x)
            out.append(x)
        return out[2], out[3], out[4]


class Neck(nn.Module):
    """five alternating 1x1/3x3 convolutions, then the 3x3 + 1x1 output branch"""

    def __init__(self, ci, c, no):
        super().__init__()
        self.five = nn.Sequential(Cbl(ci, c, 1), Cbl(c, 2 * c, 3), Cbl(2 * c, c, 1),
                                  Cbl(c, 2 * c, 3), Cbl(2 * c, c, 1))
        self.out = nn.Sequential(Cbl(c, 2 * c, 3), nn.Conv2d(2 * c, no, 1))

    def forward(self, x):
        x = self.five(x)
        return x, self.out(x)


class YoloV3(nn.Module):
    strides = (32, 16, 8)

    def __init__(self, width=1.0, nc=80):
        super().__init__()
        s = lambda c: scaled(c, width)
        no = 3 * (5 + nc)
        self.nc = nc
        self.back = Darknet53(width)
        self.n1 = Neck(s(1024), s(512), no)
        self.r1 = Cbl(s(512), s(256), 1)
        self.n2 = Neck(s(256) + s(512), s(256), no)
        self.r2 = Cbl(s(256), s(128), 1)
        self.n3 = Neck(s(128) + s(256), s(128), no)

    def forward(self, x):
        c3, c4, c5 = self.back(x)
        x, y1 = self.n1(c5)
        x = torch.cat([F.interpolate(self.r1(x), scale_factor=2.0, mode="nearest"), c4], 1)
        x, y2 = self.n2(x)
        x = torch.cat([F.interpolate(self.r2(x), scale_factor=2.0, mode="nearest"), c3], 1)
        _, y3 = self.n3(x)
        return [y1, y2, y3]


class YoloV3Tiny(nn.Module):
    strides = (32, 16)

    def __init__(self, width=1.0, nc=80):
        super().__init__()
        s = lambda c: scaled(c, width)
        no = 3 * (5 + nc)
        self.nc = nc
        self.down = nn.ModuleList([Cbl(3, s(16), 3), Cbl(s(16), s(32), 3), Cbl(s(32), s(64), 3),
                                   Cbl(s(64), s(128), 3), Cbl(s(128), s(256), 3)])
        self.c6 = Cbl(s(256), s(512), 3)
        self.c7 = Cbl(s(512), s(1024), 3)
        self.c8 = Cbl(s(1024), s(256), 1)
        self.o1 = nn.Sequential(Cbl(s(256), s(512), 3), nn.Conv2d(s(512), no, 1))
        self.r = Cbl(s(256), s(128), 1)
        self.o2 = nn.Sequential(Cbl(s(128) + s(256), s(256), 3), nn.Conv2d(s(256), no, 1))

    def forward(self, x):
        route = None
        for m in self.down:
            x = m(x)
            route = x
            x = F.max_pool2d(x, 2, 2)
        x = self.c6(x)
        x = F.max_pool2d(F.pad(x, (0, 1, 0, 1), value=-1e30), 2, 1)
        x = self.c8(self.c7(x))
        y1 = self.o1(x)
        u = F.interpolate(self.r(x), scale_factor=2.0, mode="nearest")
        y2 = self.o2(torch.cat([u, route], 1))
        return [y1, y2]


def build(name, width=1.0, nc=80):
    return (YoloV3Tiny if name == "tiny" else YoloV3)(width, nc)


def fake_targets(batch, size, strides, nc, per_image=6, seed=0):
    """For each head: objectness map, indices of the positive cells, their boxes and classes."""
    g = torch.Generator().manual_seed(seed)
    out = []
    for st in strides:
        n = size // st
        cells = batch * 3 * n * n
        idx = torch.randperm(cells, generator=g)[: batch * per_image]
        obj = torch.zeros(cells)
        obj[idx] = 1.0
        box = torch.rand(len(idx), 4, generator=g)
        cls = F.one_hot(torch.randint(0, nc, (len(idx),), generator=g), nc).float()
        out.append((obj.view(batch, 3, n * n), idx, box, cls))
    return out


def loss_fn(ys, targets, nc):
    """Darknet-like: squared box error and class BCE on assigned cells, objectness BCE everywhere."""
    total = 0.0
    for y, (obj, idx, box, cls) in zip(ys, targets):
        b, _, h, w = y.shape
        y = y.float().reshape(b, 3, 5 + nc, h * w)
        total = total + F.binary_cross_entropy_with_logits(y[:, :, 4], obj, reduction="sum")
        pos = y.permute(0, 1, 3, 2).reshape(-1, 5 + nc)[idx]
        total = total + ((pos[:, :2].sigmoid() - box[:, :2]) ** 2).sum()
        total = total + ((pos[:, 2:4] - box[:, 2:]) ** 2).sum()
        total = total + F.binary_cross_entropy_with_logits(pos[:, 5:], cls, reduction="sum")
    return total / ys[0].shape[0]


def conv_flops(model, size):
    """2*MAC of all convolutions for one image."""
    tot = 0

    def hook(m, i, o):
        nonlocal tot
        tot += 2 * o.shape[1] * o.shape[2] * o.shape[3] * m.weight[0].numel()

    hs = [m.register_forward_hook(hook) for m in model.modules() if isinstance(m, nn.Conv2d)]
    was = model.training
    model.eval()
    with torch.no_grad():
        model(torch.zeros(1, 3, size, size))
    model.train(was)
    for h in hs:
        h.remove()
    return tot


if __name__ == "__main__":
    for n, w in (("full", 1.0), ("full", 0.5), ("full", 0.25), ("full", 0.125), ("tiny", 1.0)):
        m = build(n, w)
        print(n, w, "params %.2f M" % (sum(p.numel() for p in m.parameters()) / 1e6),
              "forward %.3f GFLOP/image" % (conv_flops(m, 416) / 1e9))
