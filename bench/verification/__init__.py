"""The thesis's verifications of section 9.2 and 9.3 again, on our plant; and the learners on the pendulum."""
