"""The runner of a session: it runs the trials of a plan on a stage (the renderer), with a front (the user interface).

A trial is over when its answer is on disk in the log. Only then the next trial begins. However the process ends, a new
`Session` continues from the log with the same order and procedures. No answered trial is repeated.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal, NoReturn, TypeAlias, cast

from hapticd._version import __version__
from hapticd.base import clock
from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import Json
from hapticd.config.configuration import Config
from hapticd.experiment.event_codes import EventCode
from hapticd.experiment.front import Choice, Command, Front, Reply, Shown, Watched
from hapticd.experiment.keys import ChoiceQuestion, MeasureQuestion, NumberQuestion, SliderQuestion, TextQuestion
from hapticd.experiment.measures import measure_text, measures_of, planes_of, why_not_done
from hapticd.experiment.plan import Plan, PlannedTrial
from hapticd.experiment.procedures.procedure import Procedure
from hapticd.experiment.progress import check_not_over, progress_of
from hapticd.experiment.session_folder import SessionFolder
from hapticd.experiment.session_log import Log, Record
from hapticd.experiment.stage import ForcesLost, ForcesStopped, Stage
from hapticd.experiment.stimuli import Stimulus
from hapticd.experiment.trial_scenes import configurations, seen

MAX_FAULTS_IN_A_ROW: Final = 3
"""The session ends after this many successive attempts at trials during which the forces were switched off."""
MAX_ATTEMPTS_NOT_DONE: Final = 3
"""A motor task that was not done in this many successive attempts ends without an answer."""

Ending: TypeAlias = Literal["ended", "aborted"]
"""How a run ended: the session is over, or the experimenter aborted it."""
Procedures: TypeAlias = "Callable[[str, Json], Procedure[Any]]"
"""Function that makes an adaptive procedure from its name and its stored state; null makes a new procedure."""
AtLevel: TypeAlias = Callable[[PlannedTrial, float], tuple[Stimulus, ...]]
"""Function that returns the stimuli of a trial if its adaptive procedure shows this level."""


class _Aborted(Exception):
    """The experimenter aborted the session."""


class _AttemptRepeated(Exception):
    """The attempt at a trial does not count, and the trial begins again; if `paused`, after a pause."""

    def __init__(self, paused: bool = False) -> None:
        super().__init__()
        self.paused = paused


@dataclass(frozen=True, slots=True)
class _ArmedTrial:
    """A trial with its level, its stimuli and the configurations of its intervals, as it is presented."""

    trial: PlannedTrial
    level: float | None
    stimuli: tuple[Stimulus, ...]
    configs: tuple[Config, ...]
    shown: Shown


class Session:
    """One run of a session by one process, from the first trial, or from the point where the log ends."""

    def __init__(
        self,
        folder: SessionFolder,
        log: Log,
        plan: Plan,
        stage: Stage,
        front: Front,
        *,
        procedures: Procedures,
        at_level: AtLevel,
        keep_telemetry: bool = True,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare a run of a session.

        `monotonic_s` returns the time in s, from which response times are computed; offline it is the simulated time.
        """
        self._folder, self._log, self._plan = folder, log, plan
        self._stage, self._front = stage, front
        self._new_procedure, self._at_level = procedures, at_level
        self._keep = keep_telemetry
        self._now_s = monotonic_s
        self._progress = progress_of(log.records)
        self._procedures: dict[str, Procedure[Any]] = {}
        self._origin_s = monotonic_s() - self._progress.elapsed_s
        self._faults = 0
        self._attempts_not_done = 0
        """Number of successive attempts at a motor task that were not done."""

    @property
    def total(self) -> int:
        """Number of trials in the plan."""
        return len(self._plan.trials)

    @property
    def done(self) -> frozenset[int]:
        """Indices of the trials that were answered or skipped."""
        return frozenset(self._progress.done)

    @property
    def answered(self) -> int:
        """Number of answered trials, without those that were skipped because their procedure had ended."""
        return self._progress.answered

    def run(self) -> Ending:
        """Run the remaining trials and close the log. Call it once.

        Raises HapticdError if the stage is lost or a file cannot be written. The log stays valid, and another `Session`
        can continue from it.
        """
        check_not_over(self._folder.path, self._progress)
        resumed = self._begin()
        try:
            self._stage.fade()
            study, done = self._plan.study, len(self._progress.done)
            self._ask_between_trials(
                lambda: self._front.begin(study.title, study.instructions, done, self.total, study.may_end_early)
            )
            self._mark(EventCode.SESSION_RESUMED if resumed else EventCode.SESSION_BEGIN)
            self._run_trials()
        except _Aborted:
            self._stage.fade()
            self._record("aborted")
            self._mark(EventCode.SESSION_ABORTED)
            return "aborted"
        except HapticdError as error:
            self._abort_quietly()
            with suppress(HapticdError):
                self._record("stage_lost", because=str(error))
            raise
        except BaseException:
            self._abort_quietly()
            raise
        finally:
            self._log.close()
        return "ended"

    # ---- The session ----------------------------------------------------------------------------------------

    def _begin(self) -> bool:
        """Log the start of the run, and return whether the session was started by an earlier run."""
        moment = clock.read()
        resumed = self._progress.began
        self._record(
            "session_resumed" if resumed else "session_started",
            participant=self._plan.participant,
            session=self._plan.session,
            seed=self._plan.seed,
            version=__version__,
            stage=self._stage.describe(),
            clock={"monotonic_ns": moment.monotonic_ns, "realtime_ns": moment.realtime_ns},
        )
        if self._log.dropped is not None:
            self._front.show_line(self._log.dropped)
        return resumed

    def _abort_quietly(self) -> None:
        """Fade the forces and mark the abort, after an error. HapticdErrors meanwhile are suppressed."""
        with suppress(HapticdError):
            self._stage.fade()
            self._mark(EventCode.SESSION_ABORTED)

    def _run_trials(self) -> None:
        left = [trial for trial in self._plan.trials if trial.index not in self._progress.done]
        before: PlannedTrial | None = None
        for trial in left:
            if trial.procedure is not None and self._procedure(trial.procedure).level() is None:
                self._record("trial_skipped", trial=trial.index, because="its procedure has ended")
                continue
            because = self._stop_reason()
            if because is not None:
                self._end(because)
                return
            self._phase_and_break(before, trial)
            self._run_trial(trial)
            before = trial
        self._end("all trials are done")

    def _end(self, because: str) -> None:
        self._stage.fade()
        self._record("ended", because=because)
        self._mark(EventCode.SESSION_END)

    def _stop_reason(self) -> str | None:
        """Return the reason if a stop rule of the study ends the test now, else None."""
        stop = self._plan.study.stop
        begun = self._progress.test_began_s
        if stop.after_s is not None and begun is not None and self._elapsed_s() - begun >= stop.after_s:
            return f"the test has lasted {stop.after_s:g} s"
        wrong = stop.wrong_in_a_row
        if wrong is not None and self._progress.wrong_in_a_row >= wrong:
            return f"{wrong} wrong answers in a row"
        return None

    def _phase_and_break(self, before: PlannedTrial | None, trial: PlannedTrial) -> None:
        """Show the instructions of a new phase (practice, training, test), or a due break.

        `before` is the previous trial of the run, or None.
        """
        study = self._plan.study
        if before is None or before.phase != trial.phase:
            warmup = {"practice": study.practice, "training": study.training}.get(trial.phase)
            self._ask_between_trials(lambda: self._front.phase(trial.phase, warmup.instructions if warmup else None))
        if before is None or trial.phase != "test":
            return
        breaks = study.breaks
        every, ran = breaks.every_trials, self._progress.answered_in_test
        new_block = breaks.between_blocks and before.phase == "test" and before.block != trial.block
        if new_block or (every is not None and ran > 0 and ran % every == 0):
            self._record("break", before_trial=trial.index)
            self._mark(EventCode.BREAK_BEGIN)
            ends_s = self._elapsed_s() + breaks.least_s
            # After a note or a pause the break continues with its remaining time.
            self._ask_between_trials(lambda: self._front.rest(breaks.text, max(0.0, ends_s - self._elapsed_s())))
            self._mark(EventCode.BREAK_END)

    # ---- A trial --------------------------------------------------------------------------------------------

    def _run_trial(self, trial: PlannedTrial) -> None:
        """Run attempts at a trial until it is answered."""
        while True:
            armed = self._armed(trial)
            attempt = self._progress.attempts.get(trial.index, 0) + 1
            try:
                self._attempt(armed, attempt)
                return
            except _AttemptRepeated as again:
                if again.paused:
                    self._pause()
            except _Aborted:
                self._record("trial_given_up", trial=trial.index, attempt=attempt, because="aborted")
                raise

    def _armed(self, trial: PlannedTrial) -> _ArmedTrial:
        level, stimuli = None, trial.stimuli
        if trial.procedure is not None:
            level = self._procedure(trial.procedure).level()
            assert level is not None
            stimuli = self._at_level(trial, level)
        configs = configurations(self._plan.study, stimuli)
        return _ArmedTrial(trial, level, stimuli, configs, self._shown(trial, stimuli, configs))

    def _attempt(self, armed: _ArmedTrial, attempt: int) -> None:
        trial, stage = armed.trial, self._stage
        target = self._folder.trial_file(trial.index, attempt)
        notes: dict[str, Json] = {"trial": trial.index, "attempt": attempt, "participant": self._plan.participant}
        self._record(
            "trial_started",
            trial=trial.index,
            attempt=attempt,
            file=target.name if self._keep else None,
            level=armed.level,
            stimuli=[{"name": each.name, "levels": dict(each.levels)} for each in armed.stimuli],
        )
        try:
            with stage.recording(target, notes):
                reply, onset_s, asked_s = self._present(armed, attempt)
        except (ForcesLost, ForcesStopped) as lost:
            stage.fade()
            self._repeat_attempt(trial, attempt, lost)
        answered_s = self._answered_s
        self._check_faults(trial, attempt)
        measures = self._measures_if_done(armed, attempt, reply, self._measures(armed))
        self._answer(armed, attempt, reply, measures, onset_s, asked_s, answered_s)
        self._mark(EventCode.TRIAL_END, trial=trial.index, attempt=attempt)

    def _present(self, armed: _ArmedTrial, attempt: int) -> tuple[Reply, float, float]:
        """Present the intervals of a trial one after another, and ask its question.

        Returns the reply, and the onsets of the first and the last interval in s on the session's clock.
        """
        stage, shown = self._stage, armed.shown
        mark = partial(self._mark, trial=armed.trial.index, attempt=attempt)
        onset_s = asked_s = 0.0
        for number, config in enumerate(armed.configs, 1):
            stage.arm(config)
            if number == 1:
                mark(EventCode.TRIAL_ARMED)
                self._ask_during_attempt(
                    armed, attempt, lambda: self._front.ready(shown, self._watched(armed, attempt))
                )
            if not stage.is_clear():
                self._ask_during_attempt(armed, attempt, partial(self._front.withdraw, shown, number, stage))
            # Commands that came before the forces are on keep them off. Later ones are obeyed right after `enable`.
            self._ask_during_attempt(armed, attempt, self._front.may_enable)
            stage.enable()
            self._ask_during_attempt(armed, attempt, self._front.may_enable)
            mark(EventCode.INTERVAL, interval=number)
            asked_s = self._elapsed_s()
            onset_s = onset_s or asked_s
            if number < len(armed.configs):
                self._ask_during_attempt(armed, attempt, partial(self._front.explore, shown, number, stage))
                stage.fade()
                mark(EventCode.FORCES_OFF, interval=number)
        reply = self._ask_during_attempt(armed, attempt, lambda: self._front.ask(shown, stage))
        self._answered_s = self._elapsed_s()
        assert isinstance(reply, Reply)
        stage.check()
        mark(EventCode.ANSWER)
        stage.fade()
        mark(EventCode.FORCES_OFF, interval=len(armed.configs))
        return reply, onset_s, asked_s

    def _answer(
        self,
        armed: _ArmedTrial,
        attempt: int,
        reply: Reply,
        measures: Mapping[str, float | None],
        onset_s: float,
        asked_s: float,
        answered_s: float,
    ) -> None:
        """Write one record to the log, with the answer to a trial and the new state of the trial's procedure."""
        trial = armed.trial
        question = self._plan.study.questions[trial.question]
        answer: Json = reply.answer
        if isinstance(question, MeasureQuestion):
            answer = measures[question.measure]
        right = None if trial.correct is None else reply.answer == trial.correct
        state: dict[str, Json] = {"procedure": None}
        if trial.procedure is not None:
            assert armed.level is not None
            procedure = self._procedure(trial.procedure)
            procedure.answer(armed.level, right is True)
            state = {"procedure": trial.procedure, "procedure_state": procedure.state()}
        self._record(
            "answer",
            trial=trial.index,
            attempt=attempt,
            phase=trial.phase,
            answer=answer,
            timed_out=reply.timed_out,
            correct=None if right is None else int(right),
            onset_s=onset_s,
            duration_s=answered_s - onset_s,
            response_time_s=answered_s - asked_s,
            level=armed.level,
            measures=dict(measures),
            **state,
        )
        self._front.answered(self._watched(armed, attempt), answer, right, answered_s - asked_s)
        self._show_feedback(armed, right, measures)

    def _show_feedback(self, armed: _ArmedTrial, right: bool | None, measures: Mapping[str, float | None]) -> None:
        study, trial = self._plan.study, armed.trial
        warmup = {"practice": study.practice, "training": study.training}.get(trial.phase)
        wanted = study.feedback if warmup is None else "correctness" if warmup.feedback else "none"
        if wanted == "none":
            return
        lines, judged = [], wanted == "correctness" and right is not None
        if judged:
            label = next((each.label for each in armed.shown.answers if each.name == trial.correct), trial.correct)
            lines.append("Correct." if right else f"Wrong: {label}.")
        question = study.questions[trial.question]
        asked = (question.measure,) if isinstance(question, MeasureQuestion) else ()
        for name in measures if wanted == "measure" else asked:
            value = measures[name]
            if value is not None:
                lines.append(measure_text(name, value))
        if lines:
            self._front.feedback(" ".join(lines), trial.correct if judged else None)

    def _measures_if_done(
        self, armed: _ArmedTrial, attempt: int, reply: Reply, measures: Mapping[str, float | None]
    ) -> Mapping[str, float | None]:
        """Return the measures of a trial, or raise _AttemptRepeated if it is a motor task that was not done.

        After the time limit, or after MAX_ATTEMPTS_NOT_DONE attempts, the measure that was not done is None instead.
        """
        question = self._plan.study.questions[armed.trial.question]
        if not isinstance(question, MeasureQuestion):
            return measures
        why = why_not_done(question.measure, measures[question.measure])
        if why is None:
            self._attempts_not_done = 0
            return measures
        self._attempts_not_done += 1
        if reply.timed_out or self._attempts_not_done >= MAX_ATTEMPTS_NOT_DONE:
            self._attempts_not_done = 0
            return {**measures, question.measure: None}
        self._give_up(armed.trial, attempt, because=f"not done: {why}")
        self._front.not_done(armed.trial.index + 1, why)
        raise _AttemptRepeated

    def _measures(self, armed: _ArmedTrial) -> Mapping[str, float | None]:
        """Return the measures that the study asks for, from the telemetry of the trial."""
        study = self._plan.study
        question = study.questions[armed.trial.question]
        wanted = list(study.trial.measures)
        if isinstance(question, MeasureQuestion) and question.measure not in wanted:
            wanted.append(question.measure)
        if not wanted:
            return {}
        telemetry = self._stage.telemetry()
        scene = armed.configs[-1].scene.to_dict()
        found = measures_of(telemetry.samples, telemetry.events, planes_of(cast("dict[str, Json]", scene["objects"])))
        return {name: found[name] for name in wanted}

    def _check_faults(self, trial: PlannedTrial, attempt: int) -> None:
        """Give up an attempt at a trial (`_repeat_attempt`) if the forces were switched off during the attempt."""
        try:
            self._stage.check()
        except HapticdError as error:
            self._repeat_attempt(trial, attempt, error)
        self._faults = 0

    def _repeat_attempt(self, trial: PlannedTrial, attempt: int, because: HapticdError) -> NoReturn:
        """Give up an attempt at a trial after the error `because`.

        Raises _AttemptRepeated, with a pause if another client stopped the forces. The last of MAX_FAULTS_IN_A_ROW
        successive errors is raised itself.
        """
        self._faults += 1
        self._give_up(trial, attempt, because=str(because))
        if self._faults >= MAX_FAULTS_IN_A_ROW:
            raise because
        self._front.show_line(f"trial {trial.index + 1} begins again: {because}")
        raise _AttemptRepeated(paused=isinstance(because, ForcesStopped)) from None

    # ---- Communication with the front -----------------------------------------------------------------------

    def _ask_during_attempt(
        self, armed: _ArmedTrial, attempt: int, ask: Callable[[], Reply | Command | None]
    ) -> Reply | None:
        """Call `ask`, a method of the user interface, during an attempt at a trial, and return the reply.

        Raises _AttemptRepeated for a command to pause or repeat, because the times of the attempt would be invalid, and
        _Aborted for a command to abort. After a note `ask` is called again.
        """
        while True:
            result = ask()
            if not isinstance(result, Command):
                return result
            if result.kind == "note":
                self._record("note", text=result.text, trial=armed.trial.index)
                continue
            self._stage.fade()
            if result.kind == "abort":
                raise _Aborted
            self._give_up(armed.trial, attempt, because=result.kind)
            raise _AttemptRepeated(paused=result.kind == "pause")

    def _ask_between_trials(self, ask: Callable[[], Command | None]) -> None:
        """Call `ask`, a method of the user interface, between trials until it returns no command, and obey commands.

        Raises _Aborted for a command to abort.
        """
        while (result := ask()) is not None:
            if result.kind == "abort":
                raise _Aborted
            if result.kind == "note":
                self._record("note", text=result.text)
            elif result.kind == "pause":
                self._pause()
            else:
                self._front.show_line("repeat: no trial is running")

    def _pause(self) -> None:
        self._record("paused")
        self._mark(EventCode.PAUSE_BEGIN)
        self._ask_between_trials(self._front.paused)
        self._record("continued")
        self._mark(EventCode.PAUSE_END)

    def _watched(self, armed: _ArmedTrial, attempt: int) -> Watched:
        trial, progress = armed.trial, self._progress
        return Watched(
            index=trial.index,
            attempt=attempt,
            condition=trial.condition,
            cell=trial.cell,
            stimuli=tuple(each.name for each in armed.stimuli),
            correct=trial.correct,
            level=armed.level,
            answered=progress.answered,
            right=progress.correct,
        )

    def _shown(self, trial: PlannedTrial, stimuli: Sequence[Stimulus], configs: Sequence[Config]) -> Shown:
        study = self._plan.study
        question = study.questions[trial.question]
        shown = Shown(
            number=len(self._progress.done) + 1,
            total=self.total,
            at_most=study.may_end_early,
            phase=trial.phase,
            stimuli=len(stimuli),
            in_places=study.trial.presentation == "places",
            surfaces=seen(study, configs, len(stimuli)),
            text=question.text,
            kind=question.kind,
            time_limit_s=study.time_limit_s,
        )
        if isinstance(question, ChoiceQuestion):
            answers = tuple(Choice(each.name, each.label, each.key, each.means) for each in question.answers)
            return replace(shown, answers=answers)
        if isinstance(question, SliderQuestion):
            ends = (question.low_label, question.high_label)
            return replace(shown, low=question.low, high=question.high, step=question.step, ends=ends)
        if isinstance(question, NumberQuestion):
            return replace(shown, low=question.low, high=question.high)
        if isinstance(question, TextQuestion):
            return replace(shown, most_characters=question.most_characters)
        return shown

    # ---- Bookkeeping ----------------------------------------------------------------------------------------

    def _procedure(self, name: str) -> Procedure[Any]:
        if name not in self._procedures:
            self._procedures[name] = self._new_procedure(name, self._progress.procedures.get(name))
        return self._procedures[name]

    def _elapsed_s(self) -> float:
        """Return the time in s on the session's clock, which stands still while no process runs the session."""
        return self._now_s() - self._origin_s

    def _give_up(self, trial: PlannedTrial, attempt: int, because: str) -> None:
        self._record("trial_given_up", trial=trial.index, attempt=attempt, because=because)
        self._mark(EventCode.TRIAL_GIVEN_UP, trial=trial.index, attempt=attempt)

    def _mark(self, code: EventCode, **members: Json) -> None:
        """Send an event code to other programs. `members`, its data, must not name stimuli or conditions."""
        self._stage.mark(code.text, {"code": int(code), **members})

    def _record(self, kind: str, **members: Json) -> Record:
        record = self._log.append(kind, at_s=self._elapsed_s(), **members)
        self._progress.take(record)
        return record
