"""Rules: every threshold that a diagnosis decides by, what it means, and how it was found.

Section by section, roughly as the rooms are used; the thresholds of a name (`Rules`) are at the
end. What belongs to one effect, as its bounds and where a search for it begins, is in its `Term`,
unless it depends on the record (`BEHIND`, `LINKED`); what belongs to an algorithm of a lower layer,
as the rough inertia or the difference of two logs, has a name there.

Words:

fold                  one of two sets of samples that judge each other: a record and its hold-out,
                      or alternating stretches of one record
held out              on the fold that an effect was not fitted to; the base parameters are tuned
                      again there
whitened energy       mean square of the error after the noise filter: 1 is noise alone, the floor
floor                 whitened energy 1; as a force, N or N m: what no model of the axis could close
gap                   whitened energy of the base model less 1; in force: its error above the floor;
                      of a backlash: its width
error                 measured force less that of the loop simulated along the record's reference
reducible             what of the gap is above the floor: of force errors, rms, where it is told how
                      far a gap closes; of whitened energy everywhere else
gain                  share of the whitened energy, noise included, that an effect removes held out
block t value         t value of a sum over blocks of `BLOCK` seconds, which count as independent
smooth law            columns over the state of the axis or its past: fixed ones where noise is
                      learnt, hats where an effect is judged, a penalised spline as a force without
                      a name
force without a name  the smooth law that predicts held-out data best
line                  a force that is periodic over position
twin                  another effect of a round that cannot be told from the best one
rival                 another effect of a round that can (`RIVAL`, "rival" in `WEIGHTS`)
most                  more than half (`MOST`)
to stand              of an effect: to be as large beside a force without a name as by itself
x, of y               x as a share of y ("speed, of the largest": speed over the largest speed)
valley                a minimum too narrow to be found by gradients
second mass           a load behind a spring or a backlash

Sources of the values: *theory* (follows from a definition), *physics* (what machines can have),
*training* (withheld effects of seeds below 1000, never those that are published, see
benchmarks/withheld), *EMPS* (the measured records of the EMPS benchmark), *numerics* (rounding,
resolution, convergence), *cost* (of computing), *definition* or *convention* (of a word),
*judgement* (of the cases that are named, or of none), *taste* (what is worth a word). Of a value
without a source only the meaning is known.
"""

from __future__ import annotations

from dataclasses import dataclass

#: Factor by which two amplitudes of one effect may differ and still agree (training; widths of
#: backlash: 1.6 of one that is there, 2.3 of a spring that has the form of a backlash).
AGREES = 1.67
#: Block t value from which it is sure that something is there: a wrong gain (training: 0 of 100
#: records without; one of 60 healthy pairs had one with 6.5), or a base parameter that has changed,
#: between two records (training: 0 of 100) or from a simulator to its axis.
SURE_T = 8.0

# --- shares: how much of anything -------------------------------------------------------------
# One scale, of which most is asked of how much of something there is; a share with a number of its
# own was found to need it. Of what each is asked, and what was seen there, is told below it.

#: Hardly any:
#:
#: - of a gain, or of what names remove: two effects whose gains differ by less do equally well (if
#:   what they leave differs by `LITTLE` at most), the one with fewer parameters gets the name, and
#:   no t value tells them apart (judgement: a spring and gravity over a short arc differ by 1e-5 to
#:   0.0052, one of them named for the other with a t value of 4; two laws of the speed by 0.012 to
#:   0.019, of twelve pairs the better one right);
#: - of the energy: an effect with less gain in the screening is not fitted (cost);
#: - of the force error: if all names together lower it by less, they fall (judgement: of two false
#:   names, on a healthy arm and a healthy axis with encoder noise, the larger lowered it by
#:   0.0005). Where one was decided at the controller, any fall is enough, and a limit counts as
#:   such if it lowers the error by this. Of the energy of the noise: settings of a controller are
#:   put right if that removes more;
#: - of a line's gain: smooth laws add no more where there is nothing but the line (judgement: a
#:   curve that is no sine leaves more);
#: - of the command's energy, left as parity error: behind an undeclared limit the law is right, and
#:   no other one is asked for (judgement); of all that error, outside of one place: that is a bad
#:   row (judgement);
#: - of the error, by a corrected controller: less is not worth a line of its own (taste).
HARDLY_ANY = 0.006
#: Little:
#:
#: - of what all names remove: an effect without which the model loses less is dropped again; the
#:   last one if it loses less of what that one removed (training). Smooth laws that add less to one
#:   turn of an encoder say nothing against it (training: 0.017 to 0.043 of three whose second
#:   harmonic is 3 to 5 %);
#: - of the whole gap: an effect similar to a named one must remove more, but for a second mass of
#:   which no smooth law could have most (`NEARLY_ALL`);
#: - of an effect's energy: it stands beside a force without a name, fitted with it, if it keeps
#:   more there, and its amplitude `AGREES` with that by itself (training: of 30 names of forces
#:   without one, which replicate by themselves, two stand; of 25 true ones, lost behind something
#:   else, ten);
#: - of the noise's energy, removed by all names: beyond that any fall of the force error is enough,
#:   for fast noise is most of it, and the effect stands out of it (judgement: of the two false
#:   names above the larger removed 0.02);
#: - of the parity error: a law of a few past samples, whatever its kind, is there if it leaves
#:   less, also of what the command's own past leaves (training: 0.0 where the axis file lacks a
#:   filter, 0.14 on EMPS, 1 in noise); of its energy, left by a limit where the law was cut at few
#:   of the samples at the top, beside the log's noise, and of the command's (judgement: nothing
#:   else takes nearly all of it; in training 2e-4, 6e-3 and 0.013 are left);
#: - of a gain: a smaller error is not worth a name where noise of the log hides the law
#:   (judgement);
#: - of a step: values that are off its multiples by less are rounded to it (numerics: digits of a
#:   log);
#: - of the gap: what closes less closes nothing by itself (training); of a record: outside the
#:   other one's range more is worth a remark (taste); of a signature: a motion that is worth advice
#:   has more that the other effect cannot imitate (judgement);
#: - of the force by which simulator and axis differ: named effects must explain more, for a
#:   difference of two logs is right to first order only (judgement on a few drawn models: a lag
#:   named where only parameters differ explained 0.04 of it, two effects that were missed 0.07,
#:   0.2);
#: - of a base parameter: a smaller change is not worth a word (physics: friction warms up);
#: - of a stroke or time: as far as a law may be carried beyond it (training);
#: - of the samples of a window, the largest: they do not count, for noise may have heavy tails
#:   (training: with all samples six of 100 pairs had an event without one; of bursts, none is
#:   lost);
#: - of a limit, or of what another effect leaves: a command that is more above it has another limit
#:   (numerics), and what leaves more does not do equally well (judgement: at a gap of 1800 times
#:   the noise a spring for gravity leaves 3.8 times as much, and gains 0.997 of what that gains);
#: - of the reducible gap, left open: no other answer and no second mass is looked for (training);
#:   of the energy without a second mass, removed by the best point of a generation: the search goes
#:   on (training: of 16 gaps and 9 springs the first generation leaves 0.34 to 0.91; where there is
#:   none it leaves 0.92 to 1.2, unless something else looks like it);
#: - of the samples of a window that stands out: no more of them do not count (training); of the
#:   largest command, below it: where an integrator is taken to stand, for a first look at a noisy
#:   limit (training); of the command's variance: a law times a factor that leaves no more is this
#:   law in another unit (a worse fit is a remainder);
#: - of the largest acceleration, from which the axis accelerates (taste); of the samples, at which
#:   a known input may step to have edges of its own (judgement).
LITTLE = 0.05
#: Some:
#:
#: - of the energy: a valley that removes less is not worth following (training);
#: - of a record that stands out, and no smooth law explains: a second mass is looked for
#:   (training); of one that lies where the other has been: if it is less, all of it counts, for
#:   that has too few blocks for any effect (training); of one that the hold-out has too: that is
#:   refused (training);
#: - of what a force without a name removes: names by which such a force over several signals needs
#:   one fewer stay beside it if it removes less with them than alone by at most this (training: of
#:   13 true names behind a real background that were lost for 0.01 to 0.1 seven spare it one; of 36
#:   false ones one, lost for 0.103);
#: - of the force error: a force without a name that is smaller is not worth a word (taste); of the
#:   force: noise that is larger is (judgement);
#: - of the spread of what a law gives where a command is at its limit: the command's is less there
#:   (training: 0.29 where a gain was wrong and what was logged had a background; up to 0.01 in
#:   seven records at a limit); of a reference's size, by which it has left itself before it comes
#:   again (numerics);
#: - of what one of two effects cannot imitate: a motion by which it grows more is worth advice; and
#:   of the largest command: a dither has that size (taste).
SOME = 0.1
#: A good part:
#:
#: - of the gap, removed on both folds: `DISCREPANCY_T` is enough to pass, for another effect may
#:   hide it (training: friction over position and a spring, 0.37 and 0.36);
#: - of one record's whitened energy, removed by a second mass that was looked for in both: it is
#:   looked for in that one alone (cost: 0.9 in one that rattles; in seven of the slowest records
#:   nothing was found in both);
#: - of the energy above the floor that all names leave: a second or later name falls if it removes
#:   less (training: of nine such names that left more than 1.05 three right ones removed 1.2 times
#:   as much or more, as those of EMPS do, and five wrong ones 0.05 to 0.13 times);
#: - of what is left above the floor: it repeats if a force without a name removes that much
#:   (definition). Then the model is not adequate;
#: - of the noise's energy, beside it: a model that leaves no more reproduces a record, so that its
#:   base parameters are the axis's (training);
#: - of the energy: a large gap is searched a second time if the first search leaves more (training:
#:   half of such searches end where 0.35 is left, the others where 0.04 is).
GOOD_PART = 0.3
#: Most, of anything (definition). Of an effect that no smooth law could have most of, no force
#: without a name outmatches the name; a line over position must have most of all that smooth laws
#: and the line remove (training: 0.51 to 0.97 of twelve lines beside a real background or a
#: nameless force, 0.30 to 0.51 of four that were bumps). Another law, limit or filter must explain
#: most of what the declared one leaves, and a smooth reference, or one that is derived otherwise,
#: most of what the logged one does; fitted columns leave most of the degrees of freedom; an axis
#: whose distance from its reference is most of the motion does not follow it; a change of an added
#: input is a step too if it is most of the largest (what follows one does not count where a log
#: does not have its time); and a stretch stands out by most of the tolerance, or of `TOLERANCE` if
#: that is less (32 withheld bursts stand out by 1.6 to 45 % of the force; where the noise is a
#: thousandth, MuJoCo's dry friction, which is never quite dry, by 0.1 %). All of these are
#: judgement.
MOST = 0.5
#: Nearly all:
#:
#: - of the reducible force error: a gap that names close so far is explained (definition), as it is
#:   where they leave less than the tolerance above the floor;
#: - of the gap's energy: nothing nameless is suspected (training, seeds 300 to 330, and 900 to 982
#:   on MuJoCo; EMPS has 0.92): names that explain less, while an effect that cannot be named gains
#:   more than one of them, have not its cause (effects left out of the library, seeds 6003 to 6042,
#:   five such names, all wrong, and a gain over position of MuJoCo's called friction; of 282 true
#:   ones, of single effects, pairs, MuJoCo's and behind backgrounds, none). What removes so much by
#:   itself is excused where it is uneven (`UNEVEN`), and a force without a name that describes so
#:   much needs one standard error only (judgement: a gain that falls with the speed left 4 %, at
#:   1.8, for two steps had most of the energy);
#: - of a second mass, that no smooth law can have: if no other effect gains `RIVAL` of its gain
#:   nothing can be taken for it, and its name is right with this probability at least, however few
#:   blocks show it (training, with 0.85: backlash of MuJoCo's, seeds 1109 to 1223, whose loads
#:   rattle otherwise than any simulation of them: eight of eight, and one more of each; nothing
#:   else passes in 66 other cases there, nor in 210 of 7000 on; that was before the other fold
#:   chose between the first and the last fit of a load that rattles, as with `WEIGHTS`);
#: - of the stretches of a record, sample for sample in another: the two are one (theory);
#: - of a correlation: two signals go together, as a position and the reference that it follows
#:   (training), or another column of the law and the command (judgement); of R2: a law is taken (it
#:   explains the command, or nothing is said);
#: - of half the sampling rate: the cut-off of any low-pass (numerics: it must be below it); of the
#:   samples: a speed that is above those of so many is high;
#: - of the way from a limit to the largest command: half of these samples lie beyond it (theory: of
#:   a smooth peak three quarters of it, of a limit all); of the samples, at an undeclared limit:
#:   the record is refused, for nothing controls the axis (training, seeds 3010+).
NEARLY_ALL = 0.9

# --- parity: does the command follow from the measured position? ------------------------------

#: Samples from the position to the command that are tried (physics: bus and cycle times).
MAX_DELAY = 5
#: Samples at the start that depend on the time before the record (theory: taps plus delay), and on
#: either side of one sample at which an error counts as being there.
PARITY_HEAD = 20
#: Samples at an extreme, cut by the law there, or beyond a declared limit, before it counts as one
#: (training).
LIMIT_SAMPLES = 8
#: Share of a limit from which the command counts as being at it (numerics: 12-bit logs).
AT_LIMIT = 0.999
#: Share of the largest command from which it sits on an undeclared limit (numerics).
AT_TOP = 0.9995
#: A command with noise is at its limit down to so many median deviations below it (theory: 4
#: standard deviations), and these are at most this share of the limit (judgement: else the law
#: exceeds the command everywhere, which is another unit and no limit).
FLAT, ROUGHEST = 6.0, 0.12
#: Law over the largest command beyond which the law was cut (training).
CUT = 1.02
#: Share of the samples at the top at which the law must have been cut (training).
CUT_SHARE = 0.8
#: Relative parity error up to which the command is that of the law, and relative difference up to
#: which two numbers are one (numerics: digits of a log).
ROUNDING = 1e-7
#: Steps in which wrong gains are found at a delay (numerics: commands are nearly linear in them).
GAIN_STEPS = 3
#: Parity error's energy over the least at any delay, beyond which a delay is out after a step
#: (training: the same delays and gains in 70 records as with all of them).
DELAY_TOLD = 10.0
#: Relative error of a gain that is worth a name (physics: no gain is known better).
GAIN_ERROR = 0.004
#: Share of the parity error that wrong gains must explain (training).
GAIN_EXPLAINS = 0.2
#: Growth of the parity error's energy at which a wrong gain less is one too few; the same of the
#: error, rms, up to which another reference does as well (training).
GAIN_NEEDED = 1.02
#: Relative parity error from which a law does not reproduce the command (training).
LAW_ERROR = 0.2
#: Relative parity error up to which a record is not asked for another law, or another derivative of
#: its reference (definition: a setting of an axis file has four digits).
DIGITS = 1e-4
#: Relative parity error from which a law explains little: most of its energy (`MOST`) is enough for
#: another one, a late log and what is done at a limit are tried, and the command counts as
#: measured (physics: a digital law repeats to rounding, and to 0.3 % where log and controller
#: sample apart).
PARITY_POOR = 0.02
#: Lowest and highest cut-off of a filter that smooths a rounded reference, over half the sampling
#: rate, and how many are tried (numerics).
SMOOTHEST = (0.002, 0.9, 25)
#: Samples that are added at either end before that: this over the cut-off (numerics: until the ends
#: are settled).
EDGES = 6.0
#: Most that the filter may change, in steps: their mean square, and in one sample (theory: rounding
#: makes a twelfth and a half; corners of a motion add a little).
SMOOTHED = (0.12, 1.5)
#: Response of a law to its reference, of the median over frequencies, below which its commands tell
#: next to nothing of that, and times that the reference is put right (numerics).
LEAST_RESPONSE, IMPLIED = 1e-3, 2
#: Samples at either end of it that must be smooth where the commands do not tell them, and the
#: order of the differences that say so (numerics: accelerations show in the first three).
ENDS, ROUGHNESS = 200, 4
#: Positions are counted from nearer if their origin is further from the middle of the motion than
#: its stroke (training: of 15 forces over positions 14 have a name 1.5 strokes away, 11 four, eight
#: 20 and six a thousand; counted from near, at 1.5 and a thousand, all of them), and then from a
#: round number: a multiple of a power of this (definition).
ROUND = 10.0
#: Samples by which a command is logged late that are tried where the law explains little as it is;
#: the first, ahead of the position, where no law can be, wherever the command shows no delay
#: (judgement).
LATENESS = (-1, 1, 2)
#: Samples by which a reference is logged late that are tried where the command is not that of the
#: settings as declared (judgement: a cycle or two of a controller, and its output).
MISPLACED = (1, -1, 2, -2, 3, -3)
#: Samples of the controller per sample of a log that are tried (judgement: drives of up to 20 kHz
#: that are logged at 1 kHz).
FASTER = (2, 3, 4, 5, 8, 10, 16, 20)
#: Of the parity error's energy that other settings take at the samples of a log, what its own must
#: take at a faster rate, and of what there is at that rate, what others must take to be believed
#: (training: 0.74 of what a filter takes that is not there; settings that are wrong are so at any
#: rate).
FASTER_EXPLAINS = 0.7
#: Of the same energy, what the settings of an axis file may leave at a faster rate where no others
#: at the samples of the log take any (training: 0.44 where noise hides a law twice as fast).
FASTER_LEAVES = 0.6
#: Size, of the largest, from which a change of a reference, or of its slope, counts where one that
#: was made at a lower rate than it is logged is told (numerics: digits of a log).
SINGLE = 1e-3
#: Samples of a log by which the delay that it shows then may differ; beyond, the declared one must
#: explain nearly as much, `FASTER_EXPLAINS` (training: 0.2 where noise of the encoder hides it).
FASTER_LATE = 0.25
#: Samples of a log that tell a law, or its rate (cost).
LAW_TOLD = 4000
#: Relative errors of gains between which the parity fit searches (physics).
GAIN_RANGE = (-0.95, 9.0)
#: The same of an added input at least, whose sign may be wrong (physics).
ADDED_LEAST = -10.0
#: Blocks of the covariance of the parity fit (theory: enough for a t value of 8).
PARITY_BLOCKS = 40

# --- preflight: is the input fit to be judged? ------------------------------------------------

#: Travel of a reference, and difference of two, of the largest, up to which there is none
#: (numerics: rounding).
NO_MOTION = 1e-9
#: Seconds of usable motion at least (training: below, no effect replicates).
LEAST_TIME = 3.0
#: Samples of usable motion at least (theory: fifty per coefficient of the noise model).
LEAST_SAMPLES = 1000
#: Travel of the position per travel of its reference (physics).
FOLLOWS = (0.2, 5.0)
#: Share of the time or the way that each direction takes at least (theory: friction against
#: offset); a reference that moves for less of the time moves in steps.
ONE_WAY = 0.02
#: Relative error of a gain from which a finding says that the axis file has another one, a law that
#: another record showed is not this one's, and an added input is compared again as it acts
#: (physics).
GROSS_GAIN = 0.15
#: Command over its declared limit from which a unit must be wrong (physics).
WRONG_UNIT = 2.0
#: Share of samples at the limit beyond which nothing behind the command is named (training). If the
#: axis file states that limit, the record is refused.
SATURATED = 0.2
#: How near a factor must come to that of a unit, relative (physics).
UNIT_NEAR = 0.2
#: Samples that give a wrong unit away: of a longer record the first ones (cost).
UNIT_SAMPLES = 1_000_000
#: Ratio of recorded and expected command, or of the inertia that the record shows and that of the
#: axis file, that is absurd, either way (physics: it is a unit; gains and payloads stay below).
ABSURD = 20.0
#: Correlation of recorded and expected command below which a sign is wrong (theory).
OPPOSITE = -0.5
#: Stretches that are looked for in the other record, and their samples (numerics).
LOOKS, LOOK_WIDTH = 40, 50
#: Ratio of the inertias of two records from which they may be of two axes (physics: a payload
#: weighs less than the axis that carries it; what it changes is said). They are refused if neither
#: record can be simulated with the other's inertia either (`OTHER_VALUE`).
SAME_AXIS = 2.0

# --- pull and hanging: where no control law holds the axis ------------------------------------

#: Natural frequency, Hz, of the pull to a motion without controller (physics: as of a slow servo).
PULL_HZ = 5.0
#: The same at most, also of a velocity loop's own pull, of the sampling rate (numerics).
PULL_RATE = 0.025
#: Damping of that pull, and the cut-off of its low-pass over its natural frequency (physics: it
#: lags by 20 degrees where the pull crosses over; of 30 healthy axes with white noise of the
#: encoder 25 are adequate with it, 11 without).
PULL_DAMPING, PULL_FILTER = 0.7, 4.0
#: Phase margin, degrees, below which a velocity loop is pulled to the motion too (judgement: the
#: one of laas-motor has 1 to 4, those of ordinary drives 45 and more).
MARGIN = 15.0
#: Cut-off below which gravity is looked for, and a law behind noise that is not logged, in median
#: frequencies of the motion (judgement: above harmonics of a swing).
SLOW = 5.0
#: The same at most, of the sampling rate (numerics).
SLOW_RATE = 0.2
#: Periods of the cut-off that are left out at either end (numerics: there the low-pass sees one
#: side only).
SWING_EDGE = 0.5

# --- fold: which samples count ----------------------------------------------------------------

#: Seconds of the blocks that count as independent (EMPS: the correlation of the error).
BLOCK = 0.4
#: Seconds after the start in which the initial state still shows (training).
TRANSIENT = 0.15
#: The same where a load is known: the links are not where they would be (training: a jerk at the
#: start throws them across their gaps).
LINKED_TRANSIENT = 0.3
#: Share of the stroke beyond which an axis has left the place where it stood (physics: a brushless
#: motor is stuck in a well of its cogging for 0.3 s, and moves by a thousandth there).
MOVED_OFF = 2e-3
#: Seconds of standing reference after which the axis may be stuck anywhere (physics).
REST = 0.1
#: Speed, of the largest, below which a reference stands (numerics).
STANDING = 1e-4
#: Seconds around a clipped command that are left out (training), and that belong to a reversal or
#: to an edge of a pulse (physics: break-away).
NEARBY = 0.05
#: Whitened error of a simulation that diverged (numerics: larger than any real one).
DIVERGED = 1e6
#: Samples of a block at least (numerics: its sum is as a normal one's).
LEAST_BLOCK = 20
#: What the links of a robot leave in doubt is discounted in a joint's error; a direction in which
#: less than this share of it is, counts in full (numerics: half of the directions).
UNDOUBTED = 1e-3
#: Numbers of stretches into which a record that judges itself may be cut (training).
STRETCHES = (4, 5, 6, 7, 8, 9, 10, 11, 12, 13)

# --- response, spatial lines and floor --------------------------------------------------------

#: Seconds of impulse response of the command to a force (training: ten time constants).
RESPONSE_TIME = 0.6
#: Speeds between which a generic friction law is interpolated (training).
SPEED_KNOTS = 7
#: Speed, of the largest, from which an axis moves (numerics).
MOVES = 1e-3
#: Seconds in which a friction comes back after a reversal (physics: of asperities to of grease).
AFTER_REVERSAL = (0.005, 0.02, 0.1)
#: Bins over the stroke in the search for lines over position, and samples of the spectrum in which
#: their energy is looked up (numerics).
POSITION_BINS = 1 << 14
#: Zero padding of that spectrum (numerics: resolution of a period).
PADDING = 4
#: Speeds at which the response to a line is looked up (numerics).
LINE_SPEEDS = 40
#: Share of the sampling rate that a line may reach at high speed (theory: Nyquist, with room).
LINE_TOP = 0.35
#: Energy that is added to what any line is answered by, of the largest: else lines that hardly show
#: would be raised above the others (numerics).
FAINT_LINE = 1e-3
#: Periods over the stroke by which one line differs from the next (theory: width of a main lobe).
LINES_APART = 2
#: Periods that a stroke must hold at least for a line (theory: it must come twice).
LINE_PERIODS = 2.0
#: How near the period of an encoder's line must come to one turn, which then is it, and of which
#: the stroke need hold one only (physics: a shaft that is not in the middle of its scale;
#: judgement).
TURN = 0.01
#: Bins over a period of a line at least (numerics).
LINE_BINS = 4
#: Knots over a period of a line of the law that its bumps are taken for (theory: two are the line
#: itself).
BUMPS = 4
#: Periods, of that of the strongest line, of the lines that are taken out with it before noise is
#: learnt: its second harmonic, or what it is that of (training: a cogging with a second harmonic of
#: 0.3 was learnt as noise, three to eight times as large as that is).
RELATED_PERIODS = (1.0, 0.5, 2.0)
#: Periods per effect that the screening looks at (training).
LINES = 3
#: Order of the noise model (EMPS: partial autocorrelations vanish beyond).
NOISE_ORDER = 20
#: Seconds of the windows in which noise is compared (training).
WINDOW = 0.1
#: Samples of such a window at least (theory: its energy scatters by a fifth, not by half).
LEAST_WINDOW = 50
#: Frequency, Hz, below and above which a window must be quiet (EMPS: band of the position loop).
SPLIT_HZ = 12.0
#: Quantile of the windows that count as quiet (training).
QUIET = 0.7
#: Least share of the samples of a quiet window that must count (training).
FULL = 0.8
#: Samples per coefficient of the noise model in quiet windows, or all count (theory).
PER_COEFFICIENT = 20
#: Energy of a combination of columns, of the largest, below which they are linearly dependent
#: (numerics).
DEPENDENT = 1e-10
#: The same of force laws, along which noise is told from what they make (numerics: with 1e-11 the
#: floor of a slow force that follows nothing is 5 % higher).
SAME_LAW = 1e-12
#: A smooth law is fitted to typical samples if they show this share of its energy at least: the
#: first of these, or else the last, with which it leaves no more than so many times the error that
#: there was elsewhere (training: a joint beside one that rattles, 1e-5 to 0.01 do the same; of 52
#: healthy axes with slow noise one had a fortieth of its noise as its floor, for a law of which
#: 1e-4 showed had left 60 times the error; beside effects of the library up to 9 times are left).
SHOWN, ASTRAY = (1e-5, 1e-4, 1e-3, 1e-2, 0.1), 10.0
#: Width of the lag window that keeps the noise model stable, per sample, and its largest root
#: (numerics: the spectrum is smoothed over a hundredth of the rate).
LAG_WINDOW, LARGEST_ROOT = 0.02, 0.999
#: Bins of frequency, and least share of the noise in one that fitted columns leave (numerics).
FREQUENCIES, LEAST_LEFT = 512, 0.25
#: Robust standard deviations above the median from which a window is an event (training: 0 of 100
#: without); twice as many where a coarse sensor never changes in it, and in between in proportion
#: (training: of twenty axes of MuJoCo's without an effect two had events where half of the samples
#: were as before).
EVENT = 8.0
#: Least deviation, of the median, in that comparison (theory: chi-square of a short window).
EVENT_SPREAD = 0.15
#: Times that the noise is learnt, each on what laws leave of the windows that seemed typical before
#: (training: with three a force of position times speed leaves 1.2 to 2.4 times the noise, with two
#: up to six times).
LEARNT = 3
#: Frequencies, Hz, below which an error is slow, and the share of the force, rms, from which on
#: what smooth laws leave of it is no noise (below 5 Hz, MuJoCo: 3.2 % at most on 13 axes with noise
#: alone, 14 of 16 slow forces, pendulums and second axes above 5; a line that hardly comes again
#: has 6. Below 10 Hz: 2 % at most on 30 healthy axes of other hands; a pendulum on a fast arm,
#: which shows from 5 Hz on, has 15).
SLOW_HZ, SLOW_FORCE = (5.0, 10.0), 0.07
#: Seconds of longer windows, and deviations of their energy or mean beyond which a weak force has
#: acted for a while (training: 24 records without one are below 3.9, of three lost ones above 6).
LASTING, LASTING_EVENT = 0.5, 5.0
#: Samples of a period at least, and periods of a record at most (theory: a shape; training).
LEAST_PERIOD, MOST_PERIODS = 20, 200
#: Relative mismatch below which a reference repeats itself (numerics).
PERIODIC = 1e-4
#: Samples from its first repetition on among which the best one lies (numerics).
DEEPEST = 200
#: Samples that two passes or records must share for their difference to be a floor (training).
LEAST_PAIRS = 100
#: Most stretches, and share of a record, that an outside force may take (training); any number in
#: less than half of the record where the other one shows nothing (judgement).
FEW_EVENTS, EVENT_TIME = 5, 0.25

# --- library: where a search begins -----------------------------------------------------------

#: Where the search for a second body begins that the law sees: whoever measures it has one that
#: swings slowly and is heavy (physics: links and booms).
BEHIND: dict[str, dict[str, tuple[float, ...]]] = {
    "flexibility": {"frequency_hz": (2.5, 8.0, 25.0, 65.0), "load_share": (0.1, 0.35, 0.8)}
}
#: The same where a load is known, which pulls at the second body: a link behind a gear, heavier
#: than the drive or not, softer than a ball screw, and with friction in the drive (physics).
LINKED: dict[str, dict[str, tuple[float, ...]]] = {
    "flexibility": {
        "frequency_hz": (2.5, 13.0, 65.0),
        "load_share": (0.05, 0.2, 0.9),
        "load_friction": (0.0, 0.02, 0.5),
    },
    "backlash": {
        "gap": (1e-4, 1e-3, 1e-2),
        "contact_hz": (30.0, 120.0, 500.0),
        "load_share": (0.1, 0.35, 0.95),
        "load_friction": (0.0, 0.01, 0.1, 0.9),
    },
}

# --- screen and fit: where a search looks -----------------------------------------------------

#: Exponent of two: 2^3 starting points in each box of an effect with many minima, in the screening
#: (numerics).
GLANCE = 3
#: Least and largest share of the samples in which the base model asks for more than a limit of the
#: drive, where that is looked for in the screening (training: of twelve limits that 0.1 to 3 % of
#: the samples met, even steps of their logarithms missed the two that fewest met).
ASKED = (1e-3, 0.75)
#: Relative decrease of the cost below which sensitivities are kept (numerics).
KEEP_JACOBIAN = 0.01
#: Relative decrease of the cost that ends a fit (numerics: far below what any name is worth).
CONVERGED = 3e-4
#: Share of a parameter that may lie in directions that change nothing (numerics).
UNSHOWN = 0.01
#: Finite difference, in natural units of a parameter (numerics).
STEP = 0.01
#: Oscillations of a contact in a sample at most, as a multiple of those that are as good as rigid
#: (`Parameter.rigid`; numerics: a stiffer one takes ten times as long and tells the same).
STIFF = 4.0
#: Largest step of a shape parameter, as a factor (numerics).
REACH = 3.0
#: Jacobians of a fit at most; of one that begins near its end; of base parameters beside frozen
#: effects (numerics).
JACOBIANS, AGAIN, RETUNED = 8, 4, 3
#: Factor by which a drift may be larger or smaller in the other record, which begins at another
#: time (judgement: after 1.6 time constants a fifth of what settles is left).
GOES_ON = 5.0
#: Shares of a step that are tried until the error falls (numerics).
SHORTER = (1.0, 0.3, 0.05)
#: Jacobians that follow a narrow valley (training).
VALLEY_STEPS = 24
#: Finite differences at the bottom of one, of those on the way there (training).
NARROW = 0.1
#: Relative size of the first simplex at the bottom of one of a contact that leads, and how many
#: points it tries at most (training: of three gaps that left 2.3 to 64 times the noise two come
#: down to it; what the other fold does not bear out is not kept).
SIMPLEX, SIMPLEX_TRIES = 0.02, 600
#: Seconds of each fold that the search for a valley looks at (training: cost against success).
VALLEY_TIME = 4.0
#: Samples that this takes at most: at high rates the stretch is shorter (numerics).
VALLEY_SAMPLES = 4000
#: Exponent of two, beside the number of dimensions: 2^(2 + dimensions) points fill the box before
#: the search for a valley, whose best begin it (training: of gaps a tenth wide where the load has
#: no friction, in six dimensions, one is met at least; 9 springs, in four, are found as well as
#: from four times as many).
FIRST_CROWD = 2
#: Exponent of two at least, dimensions included: 2^7 points (training: the valley of a light link
#: is as narrow as a twentieth of its frequency, and 64 points missed one at 12.6 Hz).
LEAST_CROWD = 7
#: `FIRST_CROWD` of a second search, in the natural units of the record that shows more, where the
#: best of the first, in those of the other, leaves a `GOOD_PART` of the energy (training: a gap
#: that 512 points miss, or of which they find a shallow place).
SECOND_CROWD = 4
#: A large gap: whitened energy that everything else must leave for that, and that the base model
#: must leave on one record for effects to be looked for in it alone, where both together name
#: nothing (cost).
LARGE = 4.0
#: Exponent of two: 2^5 points at which the search for what a drive delivers begins (numerics).
DELIVERED_POINTS = 5
#: Points per dimension, and generations, of differential evolution (training).
CROWD, GENERATIONS = 5, 24
#: Mutation and recombination of differential evolution (Storn, Price, 1997).
MUTATION, RECOMBINATION = (0.4, 0.9), 0.9

# --- attribute: what is named -----------------------------------------------------------------

#: Whitened energy, where the floor is 1, below which a record counts as without a gap (training: 98
#: of 100 without an effect). Effects are looked for below it too, and named; only wider searches
#: and further laws of the speed are spared. What names leave counts as floor up to `CLEAN`, and
#: none of it from here on; in between in proportion (training, with 1.15).
ADEQUATE = 1.12
#: A record of n samples shows none up to `ADEQUATE` + (`SHORT` / n)^2, for its noise is badly known
#: (training: 26 healthy records of 1100 to 3000 samples).
SHORT = 520
#: Whitened energy below which nothing unknown is left that could favour one twin over another. A
#: t value decides between twins below it only (training). From it on what is left is described, if
#: it repeats (a force of half the floor, energy 1.25, must be). If names leave more, also more than
#: so many times what smooth laws of the base model's motion do, a force without a name may explain
#: more (training: of 39 true names one lies above, 1.041; of two false ones, 1.040 and 1.059, one);
#: and the shares of the ranking are of so much at least (numerics: how well the floor is known).
CLEAN = 1.05
#: Effects of the screening that are fitted first; of the others only what may be a rival of these,
#: or all if none of these passes (cost).
AT_FIRST = 2
#: Least gain of a rival, of the best gain: in the screening, where less is not fitted, and of what
#: leaves a second mass without one (training).
RIVAL = 0.35
#: Where an effect's loss to first order is more than so many times what makes it superfluous
#: (`LITTLE`), it is kept, and no model without it is fitted, unless an earlier one is a valley
#: (cost).
SURELY_NEEDED = 4.0
#: If the first name is doubtful, another effect is looked for beside it, then the first anew beside
#: that: so many rounds at most until two names find each other (cost: the third is needed where the
#: first name was the wrong one).
PAIR_ROUNDS = 3
#: Draws of the bootstrap of the p values (theory: resolves 0.002).
DRAWS = 500
#: Weights of a logistic regression on 810 names, 769 of them right (training: all suites but
#: `outside` of seeds 6900 to 6912, `clear` of 6418 to 6423, and names that were withdrawn). The
#: share of the gap that is removed or explained tells nothing more. That of "surpassed" is from 64
#: names, 16 of them right, of the background, unknown and clear cases of 7000 on and 6424 on: with
#: -1.5 to -2 ten to twelve of the right ones are kept, and two or three of the others.
WEIGHTS = {
    "constant": -2.9,
    "t": 2.79,
    "disagreement": -3.9,
    "rival": -0.85,
    "gain": 0.45,
    "surpassed": -1.75,
    "evenness": 2.18,
}
#: Exponent by which energy that a name leaves excuses uneven amplitudes of the blocks
#: (training, the same names: 1, 1.5 and 2 do equally well, 0 does not).
UNEVEN_LEFT = 1.5
#: What is left beyond this energy excuses no more of it (training: three smooth forces of
#: MuJoCo's of which a spring or a friction over position left 6 to 72 times the floor; none of 673
#: other names falls by it, and one of them with 2).
MOST_LEFT = 3.0
#: Evenness below which what smooth laws could have but for `LITTLE` only resembles what is there,
#: and energy that it leaves then (training: smooth forces and a cable of another hand's generator,
#: 4 to 170 times the noise: the six names of five have 0.02 to 0.07 and leave 2.6 to 13; of 500
#: right ones a friction over position has less, 0.065, and leaves 2.2, a limit of the drive has
#: 0.03, and smooth laws a quarter of it less, and a friction that is regularised has 0.013 and
#: leaves 1.3). A name that closes `NEARLY_ALL` of the gap by itself is excused: a spring of another
#: form leaves far more than the noise where the gap is 200 times the noise. One that stands beside
#: a smooth law is if it removes `MOST` of the gap: of such names of seeds 8620 to 8671 the five
#: right ones have 0.156 at least and a wrong one 0.05, with 0.4 of the gap; a wrong one of another
#: hand's generator has 0.02, with 0.2 of it, and the gravity of one measured pendulum, which is
#: right, 0.06 with 0.8.
UNEVEN, UNEVEN_LEAVES = 0.075, 2.0
#: Ends of the scales of evidence: least gain and rest, least evenness: beyond them nothing more is
#: said by more (training).
LEAST_EVIDENCE, LEAST_EVENNESS = 1e-3, 0.03
#: No name is surer (judgement: all 679 above 0.98 are right, but a cause may be of a kind that was
#: never drawn).
SUREST = 0.99
#: Probability below which nothing is named (training: names of smooth backgrounds lie below; of
#: nine between 0.5 and 0.7 seven are right, too few to count on).
LIKELY = 0.7
#: Of a name decided at the controller, without simulation: 40 of 40 were right (training).
AT_CONTROLLER = 0.98

# --- discrepancy: what repeats and has no name ------------------------------------------------

#: Knots over position (theory: what is finer is a line over position).
POSITION_KNOTS = 16
#: The same at least, of a law without room for a line's periods: of two or three nobody can tell
#: whether they are a line (judgement), and at most, of bumps as short as a period (numerics).
LEAST_KNOTS, MOST_KNOTS = 8, 64
#: A force over the position, to which other signals add `SOME` of all that it removes at most, is
#: friction if at most this share of its variance is the same forwards and backwards (training:
#: 0.002 to 0.024 of four frictions over position, 0.034 to 0.8 of 13 forces over position and
#: direction; of nine forces that need further signals none has a name by it).
EVEN = 0.03
#: Columns of smooth laws take some of any noise. So much counts as chance, in standard deviations
#: above its mean (theory: 98 % of noise takes less).
CHANCE = 2.0
#: Quantile of speed and force at which their knots begin (numerics: zero is many samples).
FIRST_KNOT = 0.02
#: Knots over position, and over speed, of what depends on both together; from zero load on there
#: are as many as over speed (theory: smooth).
COARSE_KNOTS = (8, 4)
#: Seconds in which a past motion is forgotten (physics: seals and belts), and frequencies, Hz, and
#: damping at which something beside the axis swings (physics: below the loop's bandwidth).
FORGETTING = (0.03, 0.1, 0.3, 1.0, 3.0)
RINGING, RINGING_DAMPING = (0.5, 0.9, 1.6, 3.0, 5.5, 10.0), 0.1
#: Share of what smooth laws leave that a swing explains where there is one (training, seeds 900 and
#: 901: pendulums 0.5 to 0.6; a joint of MuJoCo's that is softer than its loop 0.28; 14 axes of its
#: without an effect 0.02 at most, other forces without a name mostly 0.15, a creep 0.28 to 0.50).
SWINGING = 0.2
#: Seconds in which friction cools down again (physics: of a contact, an oil film, a housing).
COOLING = (1.0, 3.0, 10.0, 30.0)
#: Mean speed of late, of the largest, after which friction has done most of its falling (physics:
#: of an oil film; judgement).
WARM = 0.2
#: Penalties that are tried, relative to the size of the columns (training), and the weight of the
#: size of a coefficient beside its roughness: what one fold has not seen is nothing (numerics).
PENALTIES = (1e-6, 1e-4, 1e-2, 1.0, 100.0)
TO_ZERO = 0.1
#: Block t value from which a force without a name saves energy on held-out data (training). If it
#: saves so much more than names do, it surpasses them, unless with them it saves so much more than
#: alone. An effect without a name that saves as much is an alternative, and one that saves so much
#: more than another is told from it.
DISCREPANCY_T = 3.0
#: The same where that is most of the energy: fewer blocks are enough (as of dominant effects: what
#: depends on the load shows where the axis accelerates). Of a second mass of which no smooth law
#: could have most, too (training: a gap that opens in three bursts of each record has 2.4).
DOMINANT_T = 2.0
#: A force over so many signals or more may be like anything: names stay beside it if it needs one
#: signal fewer with them, and removes less with them than alone by `SOME` at most (training).
SEVERAL = 3
#: Standard errors by which a force without a name may predict worse after names than after fewer or
#: none. Names beyond that fall if that force is a law of one signal; else they count as "surpassed"
#: in `WEIGHTS` (theory: Breiman et al., 1984; training: four false names were 1.1 to 5.7 worse; of
#: true ones only one, without those that belong beside it, 2.5). By as many an effect that is
#: periodic over position must do better than friction that is, which is no effect, and than a
#: further wave of a line that is named (training: true ones reach 3, seeds 310 to 312).
STANDARD_ERRORS = 1.0

# --- verdict, remarks and advice --------------------------------------------------------------

#: Per cent of the force: a gap is negligible if less than this of it is above the floor, unless a
#: user says otherwise (taste). Negligible is a remark; for `adequate` see `ADEQUATE` and `UNSEEN`.
TOLERANCE = 2.0
#: Share of the tolerance. A model is adequate, whatever its whitened energy, if its whole error is
#: below the tolerance and less than this is left above the floor (judgement: half a step of
#: MuJoCo's own, a twentieth of a sample, makes 0.2 %).
UNSEEN = 0.25
#: Force error over the floor that is a gap: over the difference of two records of one motion, where
#: there are such (training), and over any floor where a force from outside is suspected.
OVER_FLOOR = 1.25
#: Growth of the error's energy with the other record's value of a base parameter from which that
#: has changed, whatever else is left (training: other axes).
OTHER_VALUE = 3.0
#: Confidence of the intervals of force errors, and of changes (convention).
CONFIDENCE = 0.95
#: Blocks at least, also of a short stretch, for the interval of an error (theory).
LEAST_BLOCKS = 10
#: Motions that are tried for an advice: how many times slower one is, how many times longer the
#: stroke of another, and between which paces, of the record's, and how often a third one sweeps.
SLOWER, WIDER, PACES, SWEEPS = 3.0, 3.0, (0.1, 1.0), 3
#: And a dither: its band, Hz, and how many lines it has.
DITHER_HZ, DITHER_LINES = (3.0, 50.0), 12
#: Frequency bands in which the gap is shown, Hz (taste).
BANDS = (0.0, 2.0, 12.0, 50.0, float("inf"))

# --- a user's own simulator -------------------------------------------------------------------

#: Of the force: logs of axis and simulator that differ by less are one (numerics).
SAME_LOG = 1e-6
#: Square of the least singular value, of the largest, of parameters that do not trade with each
#: other: below the first they stay where the simulator has them unless they have changed, below the
#: second in any case (numerics).
TRADING = (1e-4, 1e-8)
#: Share of dry friction by which an axis must exceed its simulator's to be said to stick where
#: that creeps (judgement; EMPS against MuJoCo as it ships: 0.49 against 0).
STICKS = 0.2

# --- robot: joints under the loads of their links ---------------------------------------------

#: A link's force on a joint counts as the joint's own if its own inertia and frictions make all of
#: it but this share (numerics).
OWN = 1e-3
#: Links that swing, its own or others', put an error on a joint. Share of it that stays when they
#: are simulated: what removes less than that may be this rest (training: 0.002 to 0.01 of it stay
#: on joints that lack nothing).
SWUNG = 0.0125
#: Speed of a drive, of the largest, from which its forces tell what its link does (physics: below,
#: stiction takes what it takes).
CRAWLING = 0.02
#: Radians or metres of the free swing along which a load counts as linear (numerics).
SMALL_SWING = 1e-3
#: Poses at which the mean inertia of a joint is taken (numerics: to some per cent).
POSES = 50
#: One part in so many of a record, its start, does not count in errors of a robot: its links swing
#: in (taste).
SWING_IN = 20
#: Times that the joints of a robot are diagnosed at most, beside what was named before (cost).
ROUNDS = 2

# --- names: what an effect must reach ---------------------------------------------------------


@dataclass(frozen=True)
class Rules:
    """What qualifies an effect for a name; the defaults were found on withheld effects (training).

    An effect passes if all of this holds. Its parameters mean what its name says. A line over
    position is no smooth law and no other wave. It is significant on both folds (`t`), a good part
    of the gap if any axis shows a little of it (`share`), and the force error falls by `worth`. To
    pass is not yet to be named: it must come near the largest gain (`equivalence_open`), be likely
    enough (`LIKELY`), stay beside a force without a name (`STANDARD_ERRORS`), and still be needed
    (`LITTLE`, `GOOD_PART`).

    How large the gain, how sure and how alike on both folds it must be is weighed together
    (`WEIGHTS`); further thresholds, each for some effects, decided nothing beside that (ablation on
    309 cases, benchmarks/withheld).

    Parameters
    ----------
    equivalence : float
        Two effects are equivalent if their gains differ by less than this share.
    equivalence_open : float
        The same where names leave `CLEAN` or more: what is left may decide between them. Also the
        margin of the largest gain within which an effect qualifies; and the share by which names
        may fall short of a force without a name that is several laws at once.
    equivalence_law : float
        Share of what a force without a name removes, by which names may fall short of it, if it is
        one law, of the state or of use (training: friction over position, a sine there and a
        parabola in the library, falls short of such a law by 0.009 to 0.016 of the gap; springs and
        drifts that are no such thing by 0.03 to 0.4).
    correlation : float
        They are not distinguishable if what they change correlates by more than this as well.
    refit : int
        Effects of the screening that are fitted: the best so many of all, and the best so many of
        those that are no function of time.
    most : int
        Most effects in a combination.
    t : float
        Least block t value of an effect's amplitude on both folds (runs of 7700 to 8210: of 4100
        right names five lie below, all of a second mass of which no smooth law could have most;
        such a one needs `DISCREPANCY_T`, or `DOMINANT_T` where it removes most of the gap, for a
        load that rattles shows in few blocks; what removes a `GOOD_PART` of it needs the
        first of these as well).
    share : float
        Least share of the reducible gap that an effect removes on both folds if any axis shows a
        little of it (`Term.everywhere`): it must be a good part of the gap (training; behind
        backgrounds, seeds 8210 on, two false names remove 0.02 and 0.05, of the true ones the least
        0.17).
    worth : float
        Least fall of the force error with a name: root of the fall of its mean square, as a share
        of the force, rms; of a tolerance below `TOLERANCE`, less in proportion (judgement: where
        the noise is a thousandth of the force, all is significant: a simulator's steps, half of
        one too late, make 0.001 to 0.003, and its dry friction, which is never quite dry, 0.0003;
        names of 12 pairs and on the EMPS records lower it by 0.008 at least, a flexible load of a
        withheld case by less than 0.005).
    samples : int
        Of each record that are diagnosed at most, where it moves most (numerics: 200,000 take a
        minute and 4 GB; judgement: 20 s of a fast controller's log).
    """

    equivalence: float = 0.12
    equivalence_open: float = 0.25
    equivalence_law: float = 0.02
    correlation: float = 0.6
    refit: int = 4
    most: int = 4
    t: float = 6.5
    share: float = 0.15
    worth: float = 0.003
    samples: int = 200_000
