"""The entry of the coder `paper`."""

from __future__ import annotations

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import Coder, CoderOption

__all__ = ["CODER"]

CODER = Coder(
    name="paper",
    encoder="touchfield.codec.paper.encoder:PaperEncoder",
    decoder="touchfield.codec.paper.decoder:PaperDecoder",
    spec=PaperSpec,
    makers={"paper": lambda asked: PaperSpec(**asked), "paper-literal": lambda asked: PaperSpec.literal(**asked)},
    options=(
        CoderOption("k", float, "Weber fraction of the deadband. [default: 0.1]"),
        CoderOption("segment_frames", int, "frames in an independent segment. [default: 8]"),
        CoderOption("interframe", str, "closed, open or none. [default: closed]"),
        CoderOption("nq", int, "bits of amplitude. [default: 6]"),
        CoderOption("directions", str, "codebook: ico5 (252), octa3 (258), ico3 (92), ico1 to ico20."),
        CoderOption("amplitude", str, "amplitude quantiser: lloyd-max (default), weber or uniform."),
        CoderOption("deadband", str, "closed, last-sent, previous, zero or none. [default: closed]"),
        CoderOption("stage", str, "dpcm, adpcm, dct, wavelet or runs in place of all these. [default: none]"),
        CoderOption("step_n", float, "with --stage: its step, newtons. [default: 0.05]"),
    ),
    resolve=PaperSpec.for_device,
    summary=lambda spec: {"stage": spec.stage} if spec.stage != "none" else {},
    has_codewords=True,
)
