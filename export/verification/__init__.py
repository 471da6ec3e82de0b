"""The trainer on other tasks: LunarLander as in the thesis's chapter 4, pitch alone as in its section 9.3."""
