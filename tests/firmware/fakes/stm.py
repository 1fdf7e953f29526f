"""The part of `stm` that the boards use: addresses of an STM32's timers, and of a register."""

TIM3 = 0x40000400
TIM4 = 0x40000800
TIM8 = 0x40010400
TIM_CCMR1 = 24
TIMERS = {3: TIM3, 4: TIM4, 8: TIM8}
