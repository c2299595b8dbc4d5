"""Thresholds of the diagnosis, each with its effect and the source of its value.

The 54 trials are wrong models of one fault each of a beam, a frame and a shear building. A change of any value moves the
figures of `benchmarks/accuracy/wrong_models.py` (cause first, false causes, wrong answers that are trusted).
"""

# the verdict
#: Half-bandwidths by which a resonance may be off: beyond one, model and measurement peak apart.
HALF_BANDWIDTHS_OFF = 1.0
#: Mean square of the whitened residual about a resonance from which on the model may miss it: twice the noise.
LOCAL_MISFIT = 4.0
#: Standard deviations of a shift from which on the verdict tells it.
TOLD_SHIFT = 3.0
#: Part of the parameters that may differ between halves of the data. Chosen on the development set.
CONTRADICTING_PART = 0.2
#: The same where one of them differs manifold: one of eight.
GROSSLY_CONTRADICTING_PART = 0.125
#: Chi-square, in parts of what is expected, that a first cause leaves from where on a second is told with it.
NOT_THE_WHOLE = 4.0
#: Chi-square, in parts of what is expected, from where on intervals from the misfit are not relied on: a length that is
#: drawn wrongly moves values by seven of their deviations, whatever part of the data they come from.
FAR_BEYOND = 9.0
#: Part of the responses, and of shapes, that the errors must be for a large misfit (root mean square); of frequencies a
#: tenth.
LARGE_ERROR = 0.02
#: Degrees of freedom that data must have beyond those that parameters take from them, or they test nothing: 1 to rounding, which
#: one value more than there are parameters leaves.
LEAST_FREEDOM = 0.99
#: Chance that stiffnesses which all moved by one ratio seem to have moved apart, so that a clock is not mentioned.
COMMON_RISK = 0.05
#: Degrees of freedom below which a residual hardly tests a model: chi-square then scatters by a third of itself.
FEW_FREEDOMS = 15
#: Part of a misfit that one change removes from where on it is the cause, if it leaves noise alone.
MOST_OF_MISFIT = 0.5
#: Of small misfits: part of what goes beyond the noise that a cause removes at least.
NEARLY_ALL = 0.85
#: Of large misfits: the same where a cause leaves more than noise, up to `NOT_THE_WHOLE`: its form is not quite the right
#: one, as of a part that is damped by another law.
WHOLE = 0.95
#: Misfit, in parts of the expected one, from where on two changes that leave noise alone are causes, whatever each
#: removes.
PAIR_MISFIT = 4.0
#: Part by which elements of one group differ though nothing is wrong: two default tolerances of 1 %.
ELEMENT_SCATTER = 0.02
#: Probability below which the size of a residual is not that of its noise; one right study of a thousand is doubted.
DOUBT = 1e-3
#: Chi-square, in parts of what is expected, up to which a noise that is stated wrongly is left alone: 12 % of its
#: deviation.
NOISE_TOLERANCE = 1.25
#: Ratio of misfit and noise from which on their difference is told.
SHOWN_RATIO = 1.1
#: Data from which on their order says whether a residual is noise. Chosen.
ORDERED_DATA = 300

# the search for causes
#: Changes that are refitted to all data. In the 54 trials the right one was among the first four of at least one list.
FINALISTS = 8
#: Sum of squares of a near fit, in parts of the best one at the same stage and the number of its parameters, from which on it
#: is left. In 16 of the wrong models the right change was the best at some stage of all, and 1.6 times the best at most.
FAR_BEHIND = 4.0
#: Changes of the records of a large model that are refitted.
LARGE_MODEL_REFITS = 4
#: Places among the finalists for changes that smoothed data do not show (friction, tones, leakage): the last ones.
RESERVED_PLACES = 3
#: Changes of sets that are added to the finalists; with 10 % of model error nobody sees a coarse mesh.
SET_REFITS = 2
#: Part of the misfit that these leave at most by a linear step.
SET_LEFT = 0.75
#: Part of the misfit that a clear first cause leaves at most.
CLEAR = 0.5
#: Part of the time of a search after which no more linear looks are taken.
SCREENING_TIME = 0.4
#: Part of the time after which no more near fits are made.
NEAR_FIT_TIME = 0.7
#: Refits that are made whatever time is left.
LEAST_REFITS = 2
#: Part of the time for first causes; what these leave is for second ones.
FIRST_CAUSE_TIME = 0.75
#: Chance that a right model within its noise is asked to change, all candidates together (Bonferroni).
REQUEST_RISK = 0.01
#: Requested changes at most that are fitted.
MOST_REQUESTED = 6
#: Lines at most of which changes are requested: what is looked for is far below the noise of any of them.
REQUEST_LINES = 2000
#: Pairs with another first cause that are looked for where the first pair leaves more than noise.
MORE_PAIRS = 4
#: Changes beside which a second promises most, that are fitted with one.
PROMISING_PAIRS = 2
#: Part of the sum of squares that another start must reach.
CLEARLY_BETTER = 0.9
#: Difference of the criterion below which two causes cannot be distinguished: odds of 20 to 1 (2 ln 20 = 5.99).
ALIKE = 6.0
#: Loss factor at which the damping of a spring is looked for.
SPRING_LOSS = 0.02
#: Part of what goes beyond the noise that a change must remove: less is lowered by many changes of any wrong model.
LEAST_SHARE = 0.10
#: Chance that any of all changes that were tried lowers the misfit as much though nothing is wrong (Bonferroni).
CAUSE_RISK = 0.01
#: Chance that a local resonance fits so much better than the simpler cause that it holds as a limit (likelihood ratio).
NESTED_RISK = 0.01
#: Frequency of a local resonance over the highest of the data from which on it is a mass, to 11 %; and so far below the
#: lowest a spring.
RIGID_RATIO = 3.0
#: Misfit of data that are left out over that of the rest, value by value, at least.
OUTLYING_RATIO = 2.0

# the screen of candidates
#: Candidates of each point of the screen that go on; in the 54 trials the right one was among the first four of some
#: point.
FIRST_OF_POINT = 6
#: Candidates of each kind, the most promising ones, that are screened at all strengths; the others at every second one.
FINELY_SCREENED = 16
#: Candidates of each kind that go on besides.
FIRST_OF_KIND = 2
#: Changes of sets of each family, the most promising ones by a linear step, that go on: two are refitted at most (`SET_REFITS`).
#: With all of them the causes of the measured frame are the same.
FIRST_OF_SET_KIND = 4
#: Candidates at most that are fitted near.
SHORTLIST = 38
#: Of those that promise most at the fit so many are fitted to the end, however a fit with 10 % of model error sees them.
CERTAIN_AT_FIT = 2
#: Part of the misfit that a candidate must promise to remove.
LEAST_DROP = 0.02
#: Supports at most that are released in all rotations.
MOST_FEET = 8
#: Change of all data together, in standard deviations, by tolerances of fixed values below which it is left out of the screen:
#: noise hides it, and a residual along it is lowered by less than a tenth.
LEAST_TOLERANCE_EFFECT = 0.3
#: Part of the misfit that goes with a sensor from where on it may be elsewhere, or of the other sense.
CHANNEL_PART = 0.3
#: Part of the misfit of the initial model that an exchange or a gain leaves at most where it is fitted whatever else is
#: seen.
INITIAL_PART = 0.5

#: Nodes at most whose place is tried: each is a changed model.
MOST_NODE_PLACES = 20

# pairs of causes
#: Changes beside which a second is looked for.
PAIR_LOOKS = 12
#: The same of each kind.
PAIR_LOOKS_OF_KIND = 2
#: Degrees of freedom up to which it is looked for: a small frame whose beams were divided has as many.
PAIR_DOFS = 200
#: Part of the misfit that two changes promise to leave at most.
PAIR_LEFT = 0.3

# fits of changed models
#: Part of its sum of squares that the next step of a fit promises at most before it is left for a better one.
RACED_AT = 0.05
#: Probability of a misfit below which noise and tolerances are not its cause.
MISFIT = 1e-3
#: Passes in which lines and tones that stand out from a fit are looked for once more.
MOST_PASSES = 4
#: Chi-square per degree of freedom that a record of another state leaves at most with values of its own.
OTHER_STATE_MISFIT = 2.0
#: Part of a misfit below which a difference is one of rounding.
SAME_MISFIT = 1e-9

#: Changed models of a small model that the process which made them keeps: its screen, near fit and refit of a change ask for
#: the same one. A worker process gets a copy of the candidate with each task, and makes its model anew.
MOST_CACHED = 64

# fixed values
#: Chance that any fixed value of a right model is doubted (Bonferroni).
DOUBT_RISK = 0.05
#: The same where all that may be wrong is then looked through.
CLEAR_DOUBT_RISK = 1e-3
#: Deviations by which a change must move a value to matter: beyond the 95 % interval and a tenth more.
MATTERS = 2.2
#: Part of the value that it must move it by: nobody minds less.
SHIFTS = 0.01
#: Tolerances beyond which a fixed value is doubted.
DOUBTED_TOLERANCES = 3.0
#: Standard deviations by which 1 % of a fixed value moves a parameter from where on it is told.
TOLD_SENSITIVITY = 0.5

# what is listed, and the time of the search
#: Causes at most of one class, and of all, that are listed.
MOST_ALIKE = 4
#: Fixed values at most that a sound answer is fitted without.
MOST_FREED = 3
#: Identifications that the search for causes may take by default,
IDENTIFICATIONS = 3.0
#: and effort besides, in seconds of the processor that efforts are measured on. With 5 a portal frame's support that turns
#: was not refitted in time.
SEARCH_EFFORT = 8.0
#: Part of this that the fit of one changed study may take, and the effort that it may take in any case.
PART_OF_ONE_FIT = 0.2
LEAST_FIT = 0.5

# effort: seconds of the processor that these were measured on. Examples of 3 to 171 degrees of freedom take 0.5 to 2 times this;
# it only says what is large beside what
#: Of one iteration of a search, whatever its size,
ITERATION_EFFORT = 1e-3
#: for each entry of its Jacobian, and of the dynamic stiffness at all lines,
ENTRY_EFFORT = 3e-8
#: for each cubed degree of freedom of its modes,
MODE_EFFORT = 1.4e-8
#: and for each value of a history, beside the dynamic stiffness at its lines.
VALUE_EFFORT = 2e-6
#: Of one entry of a residual that a candidate changes, parameters following linearly.
SCREENED_EFFORT = 2.5e-8
#: Of a changed model, assembled anew.
CHANGE_EFFORT = 0.005
#: Terms at most that the motion of a degree of freedom is summed of at each line of a history.
SUMMED_TERMS = 60
#: Degrees of freedom up to which a dynamic stiffness is full.
FULL_DOFS = 500

# records as FRFs, and lines that are looked at
#: Of FRFs made of modes: error of each value beside those of the modes, decay of the lines in parts of their frequency, lines,
#: and loads. Off the axis by 2 % damping hardly counts.
MODAL_VIEW_ERROR, MODAL_VIEW_DECAY, MODAL_VIEW_LINES, MODAL_VIEW_LOADS = 0.02, 0.02, 90, 2
#: Lines of a record that changes are fitted near on: with fewer, and fewer finalists and steps, swapped cables were lost.
NEAR_LINES = 300
#: Lines of a record, in parts of these, from where on full fits begin on so few: below, the fit on all is as quick.
WORTH_THINNING = 1.5
#: Error of each value of a quick fit, and of the start of each parameter, as parts of them.
NEAR_MODEL_ERROR, START_ERROR = 0.1, 0.2
#: Decays of the smoothed lines, in parts of their frequency, of the first steps of a quick fit,
NEAR_LEVELS = (0.06, 0.015)
#: and at which candidates are screened.
SCREENED_LEVELS = (0.12, 0.06, 0.015)
#: Complex numbers that the inverse of the dynamic stiffness may take over all lines: 320 MB; and lines that are screened
#: in any case.
MOST_INVERSE_ENTRIES, FEWEST_SCREENED_LINES = 2e7, 40
#: Modes of a large model are taken up to this multiple of the highest frequency;
MODES_BEYOND_BAND = 3.0
#: so many are computed at first, twice as many while they do not reach it, and this many at most.
FIRST_MODES, MOST_MODES = 40, 160
#: A line is outlying where its misfit is so many times that of the lines about it, of which so many are taken;
OUTLYING_LINE, LINES_ABOUT = 8.0, 21
#: side by side, more of them than this are a resonance that the model misses.
LONGEST_OUTLIER = 3
#: Tones in one look, and lines beside one at which the square of it times less of its misfit is left, at most.
MOST_TONES, TONE_SKIRT = 6, 4

# changes that follow from others
#: Ratio of delays up to which they are one, as of one card; factors on a lever that is looked at.
SAME_DELAY, OTHER_LEVERS = 1.5, (-1.0, 0.25, -0.25)
#: Nodes about that of a load or sensor where it may have been.
MOST_NEIGHBOURS = 4

# parts of the data
#: Chance that any parameter of a right model differs between two parts of the data (Bonferroni).
PARTS_RISK = 0.001
#: Relative difference below which nobody minds.
PARTS_DIFFERENCE = 0.03
#: Lines that a part has at least.
FEWEST_PART_LINES = 16
#: Ratio of two values of one parameter, and their distance in standard deviations, from which they contradict each other.
MANIFOLD, FAR_APART = 3.0, 10.0
