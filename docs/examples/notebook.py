# %% [markdown]
# # From tables of one's own to a diagnosis, in memory
#
# Run it cell by cell in an editor that knows `# %%`, or turn it into a notebook with jupytext. Nothing is
# written to disk.

# %%
import pandas as pd

import swimid

# %% [markdown]
# ## Trials
# Seven drops of the boxfish: a weight over a pulley pulls it through the tank, an encoder tells how far. A
# table has its time in `t_s` and carries its units in the names of its columns.

# %%
MASSES_KG = {"w10": 0.010, "w15": 0.015, "w20": 0.020, "w25": 0.025, "w30": 0.030, "w35": 0.035, "w40": 0.040}
tables = {name: pd.read_csv(f"sample_logs/rig/{name}.csv", comment="#") for name in MASSES_KG}
trials = swimid.load(
    [{"id": name, "log": tables[name], "pulling_mass_kg": mass} for name, mass in MASSES_KG.items()],
    experiment="falling-weight",
    robot="boxfish",
)

# %% [markdown]
# ## A fit
# Printed, a result says what the command prints; in a notebook its name alone shows it with its checks.

# %%
drag = swimid.fit_drag(trials)
print(drag)
drag.parameters

# %%
drag.correlation

# %%
drag.plot("overlay-x_m")

# %% [markdown]
# ## A model that lacks something
# Somebody holds that the pulley runs without friction. The residuals are not white, and the verdict says so.

# %%
ideal = swimid.fit_drag(trials, fixed={"pulley_friction": 0.0})
print(ideal.verdict)
ideal.checks()

# %% [markdown]
# ## Why
# Which effect of the catalogue closes the gap between that model and the trials, and how far on trials left
# out?

# %%
gap = swimid.diagnose(trials, params=ideal, effects=["pulley-friction", "pulley-inertia", "string-stretch"])
print(gap)
gap.causes

# %%
gap.shrinkage

# %% [markdown]
# ## One page of all of it
# `page.save("report.html")` would write it; `drag.save("drag.yaml")` the parameters with their evidence
# beside them.

# %%
page = swimid.report([drag, ideal, gap])
