"""All tuned numbers of the diagnosis, each with its reason."""

from __future__ import annotations

import math

# Standard deviation of one image constant, over that of a mass line: the images of a held drive sum to a sawtooth of
# the moment of sampling, of amplitude 1.
IMAGE_STD = 0.6
# What a loop may hold other than it was told: all levels alike, and each level by itself, rad.
AIM_STD = math.radians(1.0)
LOCK_STD = math.radians(0.5)
# Harmonics of a drive that was not recorded, over its fundamental.
DRIVE_HARMONIC_STD = 1e-3
# Shift of the resonance from test to test, relative.
SWEEP_SHIFT_STD = 3e-4
# Degrees of freedom of the prior of a scale: stated noise is right to a factor of about 1.5.
SCALE_DEGREES = 6.0
# Most steps of a fit; promised fall of the cost below which it has converged; largest step in prior deviations.
FIT_STEPS, CONVERGED, LARGEST_STEP = 25, 0.2, 3.0
# Fits from afar: shares of the natural size of each row that are added to its noise one after the other; steps of each.
APPROACH, APPROACH_STEPS = (0.1, 0.01, 0.001), 10
# Share of the promised fall of the cost below which sensitivities are computed anew after a step.
BROYDEN_TRUST = 0.75
# Share below which the next step is damped.
POOR_GAIN = 0.25
# Most reweightings of chain and scales for one prediction: near the optimum three suffice.
REWEIGHTINGS = 20
# Times that a fit which has not converged is continued.
CONTINUED = 3
# Search: effects that are fitted, places of each, fall of the cost below which nothing is tried.
FIRST_EFFECTS, FIRST_PLACES, LEAST_GAIN = 5, 2, 6.0
# Cosine between changes of the rows from which two effects count as one of those that are fitted.
ALIKE = 0.98
# Second effects: explanations they are added to, how many to each, fall of the cost that they must promise.
HEADS, SECOND_EFFECTS, SECOND_GAIN = 2, 2, 16.0
# Strength in standard deviations below which a member of two effects says nothing.
WEAK = 3.0
# Strength over its prior deviation from which a wider part of the prior is tried.
WIDER_STRENGTH = 2.5
# ln of a predicted over a measured line beyond which it is as good as anywhere: keeps trial steps finite.
LARGEST_LOG_RATIO = 3.0
# Prior probabilities: nothing is missing, one effect is, two are, something without a name is.
PRIOR_NONE, PRIOR_EFFECT, PRIOR_PAIR, PRIOR_UNNAMED = 0.6, 0.25, 0.05, 0.1
# Probability that what an explanation leaves is noise below which something unnamed is beside it.
ORDINARY = 0.05
# Distance in standard deviations below which two explanations are one class.
EQUIVALENT = 3.0
# Sizes that an unnamed source may have, in units of 1 % of force or response.
SOURCE_SIZES = (0.003, 0.03, 0.3, 3.0)
# ln of the odds against no gap from which a gap is claimed: four and a half to one.
ALARM = 1.5
# Fall of the cost by re-fitting the model's own parameters from which that is called a calibration.
RECALIBRATION = 25.0
# Share of the gap that an explanation which leaves more than noise has to close to be told as a partial one.
EXPLAINED = 0.95
# Standard deviations by which held-out rows must be predicted worse for an explanation to be refused.
WORSE = 1.0
# Fall of what priors of parameters and chain cost from which a further effect is worth telling, however small it is.
STRAIN = 9.0
# Explanations whose predictions of held-out rows are judged.
JUDGED = 3
# Explanations that are told; share of the likeliest detail's probability from which another is named beside it.
RANKED, AS_LIKELY = 8, 1.0 / 3.0
# Times that the chain is taken anew about the model's fit; steps of a refit to a part of the rows, and how often
# sensitivities are computed anew in it.
CHAIN_ROUNDS, REFIT_STEPS, REFIT_REFRESHES = 2, 8, 2
# Uncertainty of a prediction over the change that an explanation makes, both rms, up to which held-out rows judge it.
OPEN = 0.3
# Share of the rows below which a model without solutions cannot be compared.
FEWEST_LINES_LOST = 0.3
# Harmonics of the solution that tells what the harmonic balance leaves out: three times as many leave 2 % of it.
FINE_HARMONICS = 27
# Most lines of a random test.
RANDOM_LINES = 160
# Explanations that are fitted again about the best one, how far in ln evidence they may lie behind, and the rise of
# the cost over the model alone from which a fit has lost its way.
FINALISTS, FAR_BEHIND, LOST = 8, 40.0, 20.0
# Times that sensitivities are computed anew in the first fit of a candidate.
FIRST_REFRESHES = 3
# Share of the best fall of the cost from which the best effect is fitted at its other places, too.
OTHER_PLACES = 0.1
# Learnt scale of a group of rows from which explanations are also climbed from low levels.
STRAINED = 2.0
# Standard deviations of its prior beyond which a parameter is not credible; relative standard deviation of a limit that
# physics sets, of a drag coefficient for example.
CREDIBLE, LIMIT_STD = 3.0, 0.5
# Probability that any parameter of the model is as far off as the furthest, below which an explanation is not adequate.
INCREDIBLE = 0.01
# What is left over the floor from which it is more than noise, and the share of the gap from which that is a warning.
LEFT_OVER, SMALL_SHARE = 2.0, 0.15
# Relative standard deviation of the scale of amplitudes that a file gives without a word on its sensor.
SCALE_STD = 0.01
# Standard deviations at which an effect is seen.
SEEN = 5.0
# Modes of frequency responses: share of a response at its frequency that a mode carries in half of the channels; modal
# assurance criteria below which two modes are different and below which their order is beyond doubt; ln of the
# frequencies' ratio from which they are not the same, below which they are whatever sensors make of the shape, and
# below which they are in two tests.
MODE_SHARE, MODE_UNLIKE, MODE_ALIKE, MODE_APART, MODE_NEAR, MODE_SAME = 0.5, 0.3, 0.5, 0.5, 0.1, 0.02
# How near the model's modes are brought to the measured ones before lines are fitted, ln of frequency and damping.
MODE_FREQUENCY_STD, MODE_DAMPING_STD = 1e-3, 0.1
# Frequency over an end of the band up to which a pole that the model lacks may be noise: responses are small there.
MODE_EDGE = 1.3
# Misfit of a model that lacks nothing, over what matters: what neighbouring levels and lines share, and what each has
# for itself; change of ln level and of ln frequency over which it stays the same.
MISFIT_SHARE, MISFIT_INDEPENDENT = 0.2, 0.02
LEVEL_LENGTH, LINE_LENGTH = 1.0, 0.3
# Standard deviations by which the squares of a level's or a band's rows must exceed what noise makes of them for a
# size of what is left to be told.
SURE_EXCESS = 3.0
# Modes that the model seems to lack: ln of frequencies around one in which it has to show, and the misfit of the lines
# there from which a channel says that it is one, standard deviations.
MODE_AROUND, MODE_MISSED = 0.1, 3.0
# The same, and the share of the channels, from which no effect is tried in its place.
MODE_CERTAIN, MODE_EVERYWHERE = 10.0, 0.8
# Difference of costs below which two fits of one explanation ended in the same optimum.
SAME_OPTIMUM = 1.0
# Effects that are climbed from low levels, and ln of a group's scale over that of the model alone below which the group
# is as it was.
CLIMBED, SAME_STRAIN = 3, 0.1
