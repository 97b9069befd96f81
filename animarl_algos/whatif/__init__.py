"""What-if questions: a trained run in a changed world, beside itself in the unchanged one."""
