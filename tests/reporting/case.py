"""A small study on disk, identified, with made-up tables of select, diagnose and sample, for the report's tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from calflow.deployment.figures_alone import Levels
from calflow.deployment.run_outcome import RunOutcome
from calflow.design.candidates import candidates
from calflow.design.discrimination import NextPose, SeparationRow
from calflow.diagnosis.cause_tables import ONLY, CandidateRow, CauseProbability, CurvePoint, ModelRow
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.diagnosis.findings import Finding
from calflow.diagnosis.misfit import MisfitRegion
from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.effects.wording import NamedCause
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.certainty import Certainty
from calflow.estimation.error_model import ErrorModel, error_table
from calflow.estimation.model_tables import FitSummary, calibrated, effect_table
from calflow.files.tables import Results, to_document, to_frame
from calflow.model import Model, build
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.robot.robot import Robot
from calflow.sampling.chain import BLOBS, Chain
from calflow.sampling.posterior import ChainSummary
from calflow.stages.identify import STAGE as IDENTIFY
from calflow.stages.stage import Context
from calflow.study import load_study

ROBOT = """
name = "Arm *3* #1"
convention = "modified-dh"
[[joints]]
d_m = 0.8
limits_deg = [-120, 120]
mass_kg = 200
[[joints]]
alpha_deg = -90
limits_deg = [-100, 40]
mass_kg = 120
com_m = [0.5, 0.0, 0.0]
[[joints]]
a_m = 1.0
limits_deg = [-90, 90]
mass_kg = 80
com_m = [0.4, 0.0, 0.1]
{payload}
"""
PAYLOAD = """
[payloads."grip_$ {5 kg}"]
mass_kg = 100
com_m = [0.9, 0.0, 0.1]
"""
STUDY = """
name = "small"
title = 'Arm_1 *bold* #let $x^2$ @ref <label> "quoted" \\\\ [x] // end'
robot = "robot.toml"
workflow = "{workflow}"
seed = 3
effects = ["geometry"{compliance}]
[measurements]
file = "measured.csv"
{sigma}
[split]
holdout = {holdout}
"""
SIGMA = 5e-5  # m


@dataclass(frozen=True)
class Case:
    """What may differ between small studies."""

    poses: int = 40
    repeats: int = 1
    markers: tuple[str, ...] = ("T_*a*$#@<b>",)
    payload: bool = True
    stated: bool = True
    holdout: float = 0.3
    oriented: bool = False


def context(folder: Path, case: Case = Case()) -> Context:
    """Write the study, run identify on it, and return the context that the report is given."""
    study = load_study(_write(folder, case))
    given = Context(
        study, IDENTIFY.settings(starts=1), Results(), folder, folder / "run", lambda line: None, lambda share: None
    )
    return replace(given, results=IDENTIFY.run(given), settings=None)


def chosen(every: Sequence[Section], material: Material) -> list[Section]:
    """The sections that are in the report."""
    return [section for section in every if section.applies(material)]


def with_select(given: Context) -> Context:
    """The context with tables as the stage select makes them."""
    n = np.arange(8, 31, 2)
    worth = pd.DataFrame({"n_poses": n, **{f"O{i}": i * np.sqrt(n) for i in range(1, 6)}, "expected_sd_mm": 0.5 / n})
    worth["worst_sd_mm"] = 2 * worth["expected_sd_mm"]
    certificate = {"criterion": "tool", "n_poses": 30, "n_candidates": 2000, "n_parameters": 20, "loss": 0.0167,
                   "least_loss": 0.0166, "could_gain_percent": 0.6}  # fmt: skip
    poses = pd.DataFrame(np.random.default_rng(1).uniform(-90, 90, (30, 3)), columns=["q1_deg", "q2_deg", "q3_deg"])
    poses.insert(0, "pose", np.arange(1, 31))
    for i, axis in enumerate("xyz"):
        poses[f"nominal_{axis}_mm"] = 1000 * np.cos(np.deg2rad(poses[f"q{i + 1}_deg"]))
    poses["marker"], poses["payload"] = given.study.robot.n_joints, np.nan  # what a CSV without payloads reads as
    tables = {"select/poses.csv": poses, "select/observability.csv": worth}
    number = {"n_poses": 30, "expected_sd_mm": 0.0167, "next_ten_mm": 0.002, "knee_poses": 14, "tolerance_mm": 0.02,
              "enough_poses": 25, "needed_poses": 24}  # fmt: skip
    documents = {"select/certificate.json": certificate, "select/how_many.json": number}
    return replace(given, results=given.results | Results(tables, documents))


@dataclass(frozen=True)
class Found:
    """A row of findings.csv; rivals as there, "id joint; id joint"."""

    status: str
    cause: str = ""
    joint: int = 0
    estimate: float = np.nan
    sd: float = np.nan
    unit: str = ""
    detail: str = ""
    rivals: str = ""
    p: float = 1e-9
    gain: tuple[float, float, float] = (0.04, 0.02, 0.06)
    rows: tuple[int, ...] = ()
    statement: str = ""
    inputs: tuple[str, ...] = ()

    @property
    def others(self) -> list[tuple[str, int]]:
        """Its rivals, each an id and a joint."""
        pairs = [rival.split() for rival in self.rivals.split("; ") if rival]
        return [(cause, int(joint)) for cause, joint in pairs]


BACKLASH = Found("named", "joint-backlash", 2, 1e-4, 4e-6, "rad")
OR_HYSTERESIS = replace(BACKLASH, status="one_of", rivals="joint-hysteresis 2")
STEP = Found("named", "frame-step", 0, 3e-4, 9e-6, "m", "after row 12 in measuring order")
ORDER_OPEN = Found(
    "one_of", "joint-eccentricity", 2, 3e-4, 1e-5, "rad", "order 1", "periodic-joint-error 2; joint-error-map 2"
)
COUPLED = Found("unexplained", statement="it depends on two joints", inputs=("q2", "q3"))
WAVING = Found("unexplained", detail="period 36 s", statement="it depends on time", inputs=("time",))
WORST = MisfitRegion(input="q2", low=20.0, high=45.0, unit="deg", error_unit="mm", there=0.2, elsewhere=0.1)
MISFIT = Found(
    "unexplained",
    detail="joint 2 is between 20 and 45 deg",
    statement="the model leaves 1.80 times the noise; largest where joint 2 is between 20 and 45 deg: 0.2 mm against 0.1 elsewhere",
    gain=(np.nan, np.nan, np.nan),
)
OUTLIERS = Found("data_fault", "outlier", rows=(12, 31), statement="2 rows are far off (lines 12, 31)", p=np.nan)


CURVE = Found("named", "joint-error-map", 2, 3e-5, 4e-6, "rad", "alike over 0.15 rad")
VARIANTS = {"joint-error-map": {"low": (-1.5,) * 3, "high": (1.5,) * 3}}  # too many parameters to be sampled


def with_diagnosis(given: Context, *found: Found, poses: int = 5) -> Context:
    """The context with tables as the stage diagnose makes them; poses are proposed to tell the first rival."""
    study, tables = given.study, given.tables
    data = study.measurements()
    known = calibrated(study.robot, given.results.of({"identify"}), data.given)
    told = [one for one in found if one.status in ("named", "one_of")]
    robot = known.model.robot
    parts = [f"joint{one.joint}" if one.joint else "device" for one in told]
    fitted = {  # two steps at different moments are one here
        (one.cause, part): (one, Cause(robot, catalogue()[one.cause](robot, **VARIANTS.get(one.cause, {})), part))
        for one, part in zip(told, parts, strict=True)
    }
    model = Model(robot, (*known.model.effects, *(cause for _, cause in fitted.values())), data.given)
    added = pd.DataFrame(
        [
            {"parameter": parameter.name, "effect": parameter.effect, "variant": parameter.variant, "part": parameter.part,
             "symbol": parameter.symbol, "unit": parameter.unit, "nominal": 0.0,
             "estimate": one.estimate, "sd": one.sd, "lower": parameter.lower, "upper": parameter.upper, "at_bound": False,
             "fixed": False, "joint": parameter.joint or None, "prior_share": 0.01,
             "figure": 0.0, "calibrated": one.estimate, "meaning": parameter.meaning,
             "of_size": parameter.of_size}
            for one, cause in fitted.values() for parameter in cause.declared
        ]
    )  # fmt: skip
    parameters = pd.concat([tables["identify/parameters.csv"], added], ignore_index=True)
    names = [parameter.name for parameter in model.parameters]
    covariance = np.diag(np.concatenate([np.zeros(len(known.estimate)), added.get("sd", pd.Series(dtype=float)) ** 2]))
    covariance[: len(known.estimate), : len(known.estimate)] = known.covariance
    covariances = pd.DataFrame(covariance, columns=names)
    covariances.insert(0, "parameter", names)
    residuals = tables["identify/residuals.csv"].drop(columns=["whitened", "flagged"])
    residuals[["dx_mm", "dy_mm", "dz_mm"]] *= 0.5 ** len(told)
    summary = given.results.document("identify/summary.json", FitSummary)
    misfit = {"reduced_chi2": 3.24, "lack_of_fit_p": 1e-9} if MISFIT in found else {}
    facts = vars(summary) | misfit
    more = DiagnosisSummary(
        **facts, reduced_chi2_before=None, causes_tested=41, tests=33.0, worst=WORST if misfit else None
    )
    made = {
        "findings": _findings(found),
        "candidates": _candidates(told),
        "accuracy": _steps(given.results.rows("identify/accuracy.csv", Accuracy), told, parts),
        "next_poses": _poses([one for one in told if one.rivals], poses),
        "separations": _separations(told, poses),
        "parameters": parameters,
        "covariance": covariances,
        "errors": error_table(ErrorModel.white(known.errors.rest, len(names)), model),
        "effects": effect_table(model.effects),
        "models_in_reach": to_frame((), ModelRow),
        "cause_probabilities": to_frame((), CauseProbability),
        "needed_conditions": tables["identify/needed_conditions.csv"],
        "residuals": residuals,
        "curves": _curves(told, data.table["pose"], data.table["split"]),
    }
    own = Results(
        {f"diagnose/{name}.csv": table for name, table in made.items()}, {"diagnose/summary.json": to_document(more)}
    )
    results = given.results | own
    best, placed = calibrated(study.robot, results, data.given), data.on(robot)
    sure = Results(documents={"diagnose/certainty.json": to_document(Certainty.of(best, placed, residuals))})
    return replace(given, results=results | sure | Levels.of(best, placed).kept("diagnose"))


def _findings(found: tuple[Found, ...]) -> pd.DataFrame:
    rows = []
    for one in found:
        gain, low, high = one.gain if one.status != "data_fault" else (np.nan,) * 3
        rows.append(
            Finding(
                status=one.status, cause=one.cause, joint=one.joint or None, estimate=one.estimate, sd=one.sd, unit=one.unit,
                p_family=one.p, probability=0.97, cannot_tell_from=tuple(dict.fromkeys(cause for cause, _ in one.others)),
                gain_mean_mm=gain, gain_low_mm=low, gain_high_mm=high, heldout_mean_mm=0.08, detail=one.detail,
                **Finding.of_rivals([NamedCause(*other) for other in one.others]), rows=one.rows, statement=one.statement,
                inputs=one.inputs, numbers=(sum(row.is_cause for row in rows) + 1,) if one.status in ("named", "one_of") else (),
            )
        )  # fmt: skip
    return to_frame(rows, Finding)


def _candidates(told: list[Found]) -> pd.DataFrame:
    rows = [
        CandidateRow(cause=one.cause, joint=one.joint or None, p_family=one.p, delta_bic=-90.0, detail=one.detail,
                     part=f"joint{one.joint}" if one.joint else "device")
        for one in told
    ]  # fmt: skip
    rows += [
        CandidateRow(cause="gear-ratio-error", joint=k, p_family=0.3, delta_bic=3.0 + k, part=f"joint{k}", unit="1",
                     limit=1.234e-4 * k)
        for k in (1, 2, 3)
    ]  # fmt: skip
    rows.append(
        CandidateRow(cause="link-bending", joint=3, p_family=0.4, delta_bic=9.0, part="link3", unit="1/Nm2", limit=4e-7)
    )
    rows += [CandidateRow(cause="link-bending", joint=k, part=f"link{k}", note="why", imitated=True) for k in (1, 2)]
    warmth = "a column temperature_degC (that changes), or time_s"
    rows += [CandidateRow(cause="thermal-growth", note="why", lacking=warmth, asked=("warmth",)),
             CandidateRow(cause="gravity-deflection", note="the masses are known")]  # fmt: skip
    return to_frame(rows, CandidateRow)


def _steps(before: list[Accuracy], told: list[Found], parts: list[str]) -> pd.DataFrame:
    rows = list(before)
    last = [row for row in before if row.step == before[-1].step]
    for one, part in zip(told, parts, strict=True):
        last = [
            replace(row, model=f"{row.model} + {one.cause} {part}", step=row.step + 1, effect=one.cause, part=part,
                    joint=one.joint or None, detail=one.detail, mean_mm=0.7 * row.mean_mm, rms_mm=0.7 * row.rms_mm,
                    max_mm=0.7 * row.max_mm)
            for row in last
        ]  # fmt: skip
        rows += last
    return to_frame(rows, Accuracy)


def _poses(open_: list[Found], number: int) -> pd.DataFrame:
    rows = []
    for one in open_:
        cause, joint = one.others[0]
        rows += [
            NextPose(pose=k, readings={"q1_deg": float(k), "q2_deg": 1.0, "q3_deg": 2.0}, approach={}, payload="",
                     tells=NamedCause(one.cause, one.joint).label, rivals=(NamedCause(cause, joint).label,), leaves_open="",
                     separation_before_sd=1.2, separation_after_sd=6.5, chance_after=0.99, cause=one.cause,
                     joint=one.joint or None, rival_causes=(cause,), rival_joints=(joint,), open_causes=(), open_joints=(),
                     open_other_causes=(), open_other_joints=())
            for k in range(1, number + 1)
        ]  # fmt: skip
    return to_frame(rows, NextPose)


NO_POSE = "no pose distinguishes backlash from hysteresis in these data: log each joint's travel"


def _separations(told: list[Found], number: int) -> pd.DataFrame:
    rows = [
        SeparationRow(cause=one.cause, joint=one.joint or None, rival=other, rival_joint=joint, separation_before_sd=1.2,
                      separation_after_sd=6.5 if number else 0.0, chance_after=0.99 if number else 0.0,
                      words="what to do" if number else NO_POSE, proposed=number > 0, tested=number > 0,
                      means="" if number else "log each joint's travel")
        for one in told for other, joint in one.others
    ]  # fmt: skip
    return to_frame(rows, SeparationRow)


def _curves(told: list[Found], pose: pd.Series, split: pd.Series) -> pd.DataFrame:
    rng, blocks = np.random.default_rng(4), []
    for k, one in enumerate(told, start=1):
        side = one.cause == "joint-backlash"
        x = rng.choice([-1.0, 1.0], len(pose)) if side else np.linspace(-60, 60, len(pose))
        fitted, noise = 0.1 * (x if side else np.sin(x / 20)), 0.03 * rng.standard_normal(len(pose))
        blocks.append(
            pd.DataFrame({"finding": k, "cause": one.cause, "joint": one.joint or np.nan,
                          "variable": f"approach of joint {one.joint}" if side else f"angle of joint {one.joint}",
                          "variable_unit": np.nan if side else "deg", "x": x, "before": fitted + noise, "after": noise,
                          "fitted": fitted, "pose": pose, "split": split})
        )  # fmt: skip
    return pd.concat(blocks, ignore_index=True) if blocks else to_frame((), CurvePoint)


def with_sample(given: Context, steps: int = 40) -> Context:
    """The context with tables as the stage sample makes them, and a chain of independent draws."""
    known = calibrated(given.study.robot, given.results, given.study.measurements().given)
    sampled = [parameter.name for parameter in known.with_maps_held()[0].model.parameters]
    parameters = RunOutcome(given.results).fitted_parameters.table
    parameters = parameters[parameters["parameter"].isin(sampled)]
    n = len(parameters) + 1
    path = given.run_folder / "sample" / "chain.h5"
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(2)
    path.unlink(missing_ok=True)
    chain = Chain.open(path, 4, (2 * n, n), 0.9, print)
    for ensemble in chain.ensembles:
        ensemble.iteration, ensemble.random_state = steps, ()
        ensemble.chain, ensemble.log_prob = rng.standard_normal((steps, 2 * n, n)), np.zeros((steps, 2 * n))
        ensemble.blobs = np.zeros((steps, 2 * n), BLOBS)
    chain.save()
    names = [*parameters["parameter"], "noise.factor"]
    centre, sd = [*parameters["estimate"], 1.0], [*parameters["sd"].fillna(1e-6), 0.05]
    posterior = pd.DataFrame({"parameter": names, "unit": [*parameters["unit"], "1"], "mean": centre, "sd": sd})
    for name, shift in (("q025", -2.0), ("q500", 0.0), ("q975", 2.0)):
        posterior[name] = np.array(centre) + shift * np.array(sd)
    posterior = posterior.assign(
        rhat=1.001, ess=5000.0 + np.arange(n), prior_sensitivity=0.01, likelihood_sensitivity=0.1
    )
    residuals = given.tables["identify/residuals.csv"]
    error = np.linalg.norm(residuals[["dx_mm", "dy_mm", "dz_mm"]], axis=1)
    predictive = residuals[["pose", "repeat", "marker", "split"]].assign(
        error_mm=error, expected_mm=0.08, low_mm=0.0, high_mm=1.1 * error.max(), covered=True, heldout_coverage=1.0
    )
    summary = ChainSummary(
        steps=steps, burn_in_steps=int(steps) // 4, ensembles=4, walkers=2 * n, autocorrelation_steps=2.0,
        acceptance_independent=0.7, worst_rhat=1.001, smallest_ess=5000.0, sd_over_laplace_least=0.99,
        sd_over_laplace_most=1.01, missing_steps=0,
    )  # fmt: skip
    own = Results(
        {"sample/posterior.csv": posterior, "sample/predictive.csv": predictive, **weighed_models()},
        {"sample/summary.json": to_document(summary)},
    )
    return replace(given, results=given.results | own)


def weighed_models() -> dict[str, pd.DataFrame]:
    """Two models in reach, and their causes, as diagnose weighs them."""
    models = [
        ModelRow(model=1, change="found", causes=("joint-backlash",), joints=(1,), parts=("joint1",), details=(ONLY,),
                 log_evidence=0.0, log_prior=-3.0, probability=0.7),
        ModelRow(model=2, change="instead", causes=("joint-eccentricity",), joints=(3,), parts=("joint3",), details=("order 2",),
                 log_evidence=-0.8, log_prior=-3.0, probability=0.3),
    ]  # fmt: skip
    causes = [
        CauseProbability(cause=one.causes[0], joint=one.joints[0], part=one.parts[0], probability=one.probability,
                         found=one.model == 1)
        for one in models
    ]  # fmt: skip
    return {"diagnose/models_in_reach.csv": to_frame(models, ModelRow),
            "diagnose/cause_probabilities.csv": to_frame(causes, CauseProbability)}  # fmt: skip


def changed(given: Context, path: str, **columns: object) -> Context:
    """The context with columns of one table replaced."""
    return replace(given, results=given.results | Results({path: given.tables[path].assign(**columns)}))


def _write(folder: Path, case: Case) -> Path:
    markers = "".join(
        f"[markers.{name!r}]\npoint_m = [{0.9 + 0.1 * k}, 0.1, {0.05 * k}]\n" for k, name in enumerate(case.markers)
    )
    turned = "tool_rotation_deg = [0, 0, 0]\n" if case.oriented else ""
    (folder / "robot.toml").write_text(turned + ROBOT.format(payload=PAYLOAD * case.payload) + markers)
    (folder / "study.toml").write_text(
        STUDY.format(
            workflow="paper-table",
            compliance=', "joint-compliance"' * case.payload,
            sigma=f"sigma_m = {SIGMA}" * case.stated + f"\nsigma_rotation_rad = {SIGMA}" * case.oriented,
            holdout=case.holdout,
        )
    )
    _measure(folder, case).to_csv(folder / "measured.csv", index=False)
    return folder / "study.toml"


def _measure(folder: Path, case: Case) -> pd.DataFrame:
    robot = Robot.from_toml(folder / "robot.toml")
    model = build(robot, ("geometry", "joint-compliance") if case.payload else ("geometry",))
    rng = np.random.default_rng(0)
    truth = np.clip(0.3 * model.prior_sd * rng.standard_normal(len(model.nominal)), *model.bounds.T)
    payload = next(iter(robot.payloads), "")
    blocks = []
    for marker in case.markers:
        readings, conditions = candidates(model, case.poses, payload, marker, None, np.random.default_rng(7))
        exact, rotation = model.position(truth, conditions), model.rotation(truth, conditions)
        for repeat in range(1, case.repeats + 1):
            block = pd.DataFrame(readings, columns=["q1_rad", "q2_rad", "q3_rad"])
            block[["x_m", "y_m", "z_m"]] = exact + SIGMA * rng.standard_normal(exact.shape)
            if case.oriented:
                block[["rx_rad", "ry_rad", "rz_rad"]] = _angles(rotation)
            blocks.append(block.assign(pose=np.arange(case.poses), repeat=repeat, marker=marker))
    table = pd.concat(blocks, ignore_index=True)
    return table.assign(payload=payload) if payload else table


def _angles(rotation: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_euler("XYZ")
