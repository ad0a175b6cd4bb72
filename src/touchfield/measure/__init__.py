"""Measures of a medium: its information in bits (eq. 1 to 3), limits for any coder, the error of a decoded
field (eq. 10 and the perceptual mask), and the bit rate (eq. 9).

=====================  ================================================================================
counts                 `Counts` of arrays or of given probabilities; `field_counts`, `interaction_counts`,
                       `contact_counts` and `tool_contacts` (several contacts at once)
quantities of them     `entropy`, `joint_entropy`, `conditional_entropy`, `mutual_information`,
                       `variation_of_information`, `normalised_mutual_information`,
                       `total_correlation`, `jensen_shannon_distance`; `field_entropy`,
                       `interaction_entropy`
limits to a coder      `coding_limits`
of a device            `capacity`, `codomain_bits`
of energy              `passivity`, `loop_work_j`
of two media           `similarity`, `compression_distance`
of a collection        `descriptor`, `MediumIndex`
of a picture           `contact_along_rays`, `picture_correlation`
=====================  ================================================================================

A measured result is a `Quantity`: its unit, quantiser, weighting, estimator, interval and the
dependence of its samples travel with it.
"""

from touchfield.measure.capacity import Capacity, capacity, codomain_bits
from touchfield.measure.counts import Counts
from touchfield.measure.descriptors import Descriptor, descriptor
from touchfield.measure.estimators import ESTIMATORS, estimate_bits
from touchfield.measure.field_count import field_counts, field_entropy
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.information import (
    conditional_entropy,
    entropy,
    jensen_shannon_distance,
    joint_entropy,
    mutual_information,
    normalised_mutual_information,
    total_correlation,
    variation_of_information,
)
from touchfield.measure.interaction import (
    contact_counts,
    interaction_counts,
    interaction_entropy,
    tool_contacts,
    visits,
)
from touchfield.measure.limits import CodingLimits, coding_limits
from touchfield.measure.passivity import Passivity, loop_work_j, passivity
from touchfield.measure.quantity import Dependence, FewSamplesWarning, Interval, Quantity, Spread, spread
from touchfield.measure.retrieval import MediumIndex
from touchfield.measure.similarity import (
    Contact,
    Correlation,
    Similarity,
    compression_distance,
    contact_along_rays,
    picture_correlation,
    similarity,
)
from touchfield.medium.trace import Trace, read_trace

__all__ = [
    "ESTIMATORS", "Capacity", "CodingLimits", "Contact", "Correlation", "Counts", "Dependence", "Descriptor",
    "FewSamplesWarning", "FieldSymbols", "Interval", "MediumIndex", "Passivity", "Quantity", "Similarity",
    "Spread", "Trace", "capacity", "coding_limits", "codomain_bits", "compression_distance",
    "conditional_entropy", "contact_along_rays", "contact_counts", "descriptor", "entropy", "estimate_bits",
    "field_counts", "field_entropy",
    "interaction_counts", "interaction_entropy", "jensen_shannon_distance", "joint_entropy",
    "loop_work_j", "mutual_information", "normalised_mutual_information", "passivity", "picture_correlation",
    "read_trace", "similarity", "spread", "tool_contacts",
    "total_correlation", "variation_of_information", "visits",
]  # fmt: skip
