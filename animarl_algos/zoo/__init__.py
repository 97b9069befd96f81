"""The learners in rl_zoo3: ``python -m animarl_algos.zoo train|optimize``.

rl_zoo3's own command lines and experiment manager do the work; what is changed:

- its table of algorithms holds the learners of this project alone (its ``dqn`` is this one);
- settings come from ``zoo_configs`` with a ``--preset``, checked by name, never evaluated: rl_zoo3
  would evaluate some strings of a YAML file, import classes that one names, and evaluate
  ``KEY:VALUE`` on the command line; here the former are refused and the latter are YAML;
- for AnimaRL ids the training environment is the slot VecEnv, in which all individuals learn, and
  the evaluation environment starts from the validation split (:mod:`.manager`).
"""
