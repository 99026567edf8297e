/PROG  PALLETISE
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "layers";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 9;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50,
      TIME_SLICE	= 0,
      BUSY_LAMP_OFF	= 0,
      ABORT_REQUEST	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
   1:  PALLETIZING-B_1 ;
   2:L PAL_1[A_1] 100mm/sec CNT10     ;
   3:L PAL_1[BTM] 100mm/sec FINE     ;
   4:  PALLETIZING-END_1 ;
   5:J P[1] 100% CNT100     ;
   6:L P[2] 100mm/sec FINE Tool_Offset,PR[2]     ;
   7:L P[3] 100mm/sec FINE     ;
   8:L P[4] 100mm/sec CNT100 Skip,LBL[1]     ;
   9:L P[5] 100mm/sec CNT100     ;
/POS
P[1]{
   GP1:
	UF : 2, UT : 3,		<25|gripper|table>
};
P[2]{
   GP1:
	UF : 2, UT : 3,		<26|gripper|table>
};
P[3]{
   GP1:
	UF : 2, UT : 3,		<27|gripper|table>
};
P[4]{
   GP1:
	UF : 2, UT : 3,		<28|gripper|table>
};
P[5]{
   GP1:
	UF : 2, UT : 3,		<29|gripper|table>
};
/END
