"""What is loaded where an answer asks for more than its verdict; `structid.lazy` reads the names from here."""

from structid.diagnose.explain import diagnose_by_search as diagnose_by_search
from structid.diagnose.explain import diagnose_sound as diagnose_sound
from structid.diagnose.explain import fixed_value_sensitivities as fixed_value_sensitivities
