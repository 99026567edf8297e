/PROG  HANDLING
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "pick and place";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 10;
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
   1:  !pick a part ;
   2:  UFRAME_NUM=2 ;
   3:  UTOOL_NUM=3 ;
   4:J P[1] 100% CNT50     ;
   5:L P[2] 800mm/sec CNT10     ;
   6:L P[3] 200mm/sec FINE     ;
   7:  CALL GRIP_CLOSE ;
   8:  WAIT    .30(sec) ;
   9:L P[2] 800mm/sec CNT10     ;
  10:J P[4:"drop"] 100% FINE     ;
/POS
P[1]{
   GP1:
	UF : 2, UT : 3,		<0|gripper|table>
};
P[2]{
   GP1:
	UF : 2, UT : 3,		<1|gripper|table>
};
P[3]{
   GP1:
	UF : 2, UT : 3,		<2|gripper|table>
};
P[4:"drop"]{
   GP1:
	UF : 2, UT : 3,		<3|gripper|table>
};
/END
