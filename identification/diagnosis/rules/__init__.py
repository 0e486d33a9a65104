"""Numbers by which effects are tested, selected and judged."""

from identification.diagnosis.rules.selection_rules import RULES as RULES
from identification.diagnosis.rules.selection_rules import SelectionRules as SelectionRules
